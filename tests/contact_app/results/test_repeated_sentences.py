"""Sentences that differ in names alone become one."""

from contact_app.results.repeated_sentences import shortened, without_repetitions


def test_places_and_bodies_are_names_and_numbers_are_not() -> None:
    sentences = [
        "contacts[0]: up to 0.1 off",
        "contacts[1]: up to 0.1 off",
        "contacts[2]: up to 0.7 off",
        "soft: locks",
        "soft.skin is cut",
        "hard: locks",
    ]
    assert without_repetitions(sentences, ["soft", "hard"]) == [
        "contacts[0]: up to 0.1 off (and 1 more alike: contacts[1])",
        "contacts[2]: up to 0.7 off",
        "soft: locks (and 1 more alike: hard)",
        "soft.skin is cut",
    ]


def test_a_name_within_a_word_is_none() -> None:
    sentences = ["a: rather rough", "b: rather rough", "a: rbther rough"]
    told = ["a: rather rough (and 1 more alike: b)", "a: rbther rough"]
    assert without_repetitions(sentences, ["a", "b"]) == told


def test_the_same_sentence_twice_and_long_lists() -> None:
    assert without_repetitions(["slow"] * 3, []) == ["slow"]
    shapes = ["contacts[1]: up to 0.1 off"] * 2
    assert without_repetitions([*shapes, "contacts[2]: up to 0.1 off"], []) == [
        "contacts[1]: up to 0.1 off (and 1 more alike: contacts[2])"
    ]
    (told,) = without_repetitions([f"b{i} hangs" for i in range(20)], [f"b{i}" for i in range(20)])
    assert told == "b0 hangs (and 19 more alike: b1, b2, b3, b4, b5, … b19)"


def test_the_screen_has_the_first_of_many_sentences_of_one_kind() -> None:
    many = [
        f"b{i} slides by {0.1 * i:.3g} along {i} +x, use hold: [r{'xyz'[i % 3]}]" for i in range(4)
    ]
    other = ["b1 is stiff", "b2 is stiff", "b1 is rough"]
    (first, *rest) = shortened([*many, *other], ["b0", "b1", "b2", "b3"])
    assert first == f"{many[0]} (3 more with other numbers: see summary.json)"
    assert rest == other
    assert shortened(many[:3], ["b0", "b1", "b2"]) == many[:3]
