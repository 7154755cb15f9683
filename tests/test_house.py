"""The plan of the code, read from its files: rooms, direction of imports, size of functions.

Imports under ``TYPE_CHECKING`` and inside functions count like any other: a record that two rooms
share stands in the lower one.
"""

import ast
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

PACKAGES = ("solver", "meshes", "contact_app")

SOLVER = (
    "errors", "vectors", "exchange", "distributed", "rigid_motions", "openmp", "factors", "qp",
    "backend", "contact", "problem", "tfeti", "primal", "driver",
)  # fmt: skip
"""Rooms and modules of `solver`, lower ones first; each may import those before it."""

APPLICATION = (
    "errors", "machine", "scene", "model", "results", "accuracy", "run", "forms", "studies",
    "cli", "__main__",
)  # fmt: skip
"""The same of `contact_app`."""

STUDIES = "contact_app.studies"

MOST_ENTRIES = 12
"""Entries at the top of `contact_app`."""

LONGEST, MOST_PARAMETERS = 80, 6
"""Lines and parameters of a function."""

LONG: dict[str, str] = {}
"""Functions that are longer, with the reason."""

UNCLEAR = ("What ", "Those ", "Whose ", "Who ", "Of ", "As ", "Where ", "Which ")
"""Beginnings of docstrings without a noun that says what the object is."""

LONGEST_WITHOUT_DOCSTRING = 12
"""Lines of a function of `contact_app` that may lack a docstring."""

RIDDLES = (
    "what there is", "asked for", "gives way", "give way", "is none of", "so many along",
    "is told", "told of", "does not tell", "is seen to",
    "laid anew", "ours beside", "beside theirs", "says of it", "is believed",
)  # fmt: skip
"""Phrases of docstrings and pages that a reader had to guess at; each has a plain word instead."""

PRIVATE_NAMES = {
    "asked", "told", "said", "heard", "hear", "unfelt", "dealt", "lacks", "crossings", "bedding",
    "thinning", "whole_file",
}  # fmt: skip
"""Names that say nothing to a reader: requests, messages, load balance, … instead."""

VAGUE_NAMES = {
    "kept", "taken", "spent", "tell", "tells", "hears", "seen", "saw", "gone", "lack", "asks",
    "ours", "theirs", "blame", "askew", "astray", "hopeless", "wished", "gift", "whole", "those",
    "what", "how",
}  # fmt: skip
"""Names that do not say what the object is: remaining rows, work, …"""

EMPTY_NAMES = {"own", "found", "known", "given", "there"}
"""Names in place of the noun: outcome, local part, prescribed tractions, …"""

POINTING_NAMES = {"mine", "apart", "alike", "beside", "wanted", "there", "stands", "once"}
"""Names that point at something instead of saying what it is."""

PLAIN = {
    "solver": VAGUE_NAMES | EMPTY_NAMES | POINTING_NAMES | {"give", "carry", "brought"},
    "meshes": VAGUE_NAMES | EMPTY_NAMES | POINTING_NAMES,
    "contact_app": EMPTY_NAMES | {"apart", "mine"},
    **{
        f"contact_app/{room}": VAGUE_NAMES | POINTING_NAMES
        for room in ("scene", "model", "run", "machine", "accuracy")
    },
    "contact_app/studies": {"ours", "theirs"},
}
"""Names that a directory does not have, in addition to the private ones."""

UNCLEAR_IN_TESTS = {
    "told", "tells", "said", "says", "say", "seen", "sees", "believed", "asked", "asks", "unasked",
    "ours", "theirs", "blamed", "beside", "lacks", "whatever", "what", "speak", "silence", "words",
}  # fmt: skip
"""Words in names of tests that do not say what the program does: reports, refuses, warns, …"""

LONGEST_FILE = 500
"""Lines of a file of the packages."""

TAKE_ALL = {"Scene": 58, "Model": 72, "SolvedScene": 65}
"""Functions above the scene, the model and the answer that take all of it; others take the bodies,
the geometry, the problem or the loads that they need. A function that needs less lowers these."""

NUMBERS_OUTSIDE_OF_RECORDS = {"solver": 54, "meshes": 56, "contact_app": 219}
"""Numbers above 1e-7 at the top of modules, not in a record of options or a parameter; smaller ones
are rounding errors. A number that moves into a record lowers these."""

MANY = dict.fromkeys(("solver.qp.reference:mprgp", "solver.qp.reference:expand"), "the book's")
MANY |= dict.fromkeys(
    (
        "contact_app.forms.problem:ContactProblem.__init__", "solver.driver:solve",
        "solver.qp.smalbe:SMALBE.begin", "solver.qp.smalbe:SMALBE.solve",
        "contact_app.run.solve:solve_scene",
    ),
    "optional arguments of an interface, of which callers give a few by name",
)  # fmt: skip
MANY |= dict.fromkeys(
    (
        "contact_app.studies.commands:bench_parts", "contact_app.studies.commands:chart",
        "contact_app.studies.chart:solve_point",
        "contact_app.studies.runs:run_one", "contact_app.studies.svm_training:train",
        "meshes.repair:load_mesh", "contact_app.results.plot.space_picture:draw_space",
        "contact_app.results.plot.picture:_draw_bodies",
    ),
    "the options of a command or of a scene",
)  # fmt: skip
MANY |= dict.fromkeys(
    (
        "solver.tfeti.constraints.rows:_Part.of", "meshes.box:split_regularly",
        "meshes.overlap:refuse_overlaps", "contact_app.forms.model:build_model",
        "contact_app.forms.model:_subdomain",
        "contact_app.studies.undecomposed:_contact_rows",
    ),
    "seven, which share no record yet",
)  # fmt: skip
"""Functions with more parameters, with the reason."""


CHANGING = {
    "Counts": "the tally of a solve while it runs",
    "Agreement": "the levels of a run so far",
    "Calibration": "the levels of a run so far",
    "_Coarser": "the part of a step that is solved at the moment",
    "_Draw": "a scene while it is drawn",
}
"""Dataclasses that are state and no records."""


def modules() -> dict[str, Path]:
    """All modules by name."""
    found = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(name: str, path: Path, known: dict[str, Path]) -> set[str]:
    """Modules of the project that one module imports, wherever it does."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: relative import"
            full = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {f if f in known else str(node.module) for f in full}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return {f for f in found if f in known and f != name}


@pytest.fixture(scope="module")
def graph() -> dict[str, set[str]]:
    known = modules()
    return {name: imports(name, path, known) for name, path in known.items()}


def room(name: str, path: Path) -> str:
    """Directory of a module; the module itself at the top of a package."""
    return name if path.name == "__init__.py" or name.count(".") < 2 else name.rpartition(".")[0]


@pytest.mark.parametrize("of_rooms", [False, True])
def test_no_imports_run_in_circles(graph: dict[str, set[str]], of_rooms: bool) -> None:
    done: set[str] = set()
    place = {name: room(name, path) if of_rooms else name for name, path in modules().items()}
    edges: dict[str, set[str]] = {p: set() for p in place.values()}
    for name, others in graph.items():
        edges[place[name]] |= {place[other] for other in others} - {place[name]}

    def visit(name: str, way: tuple[str, ...]) -> None:
        assert name not in way, " <- ".join((*way[way.index(name) :], name))
        if name not in done:
            for other in sorted(edges[name]):
                visit(other, (*way, name))
            done.add(name)

    for name in edges:
        visit(name, ())


def floor(name: str, package: str, order: tuple[str, ...]) -> int:
    """Place of a module in the order; the package itself is above all it exports."""
    parts = name.split(".")
    assert parts[0] == package
    if len(parts) == 1:
        return -1
    assert parts[1] in order, f"{name} stands in no room of the plan"
    return order.index(parts[1])


@pytest.mark.parametrize(("package", "order"), [("solver", SOLVER), ("contact_app", APPLICATION)])
def test_no_room_imports_a_higher_one(
    graph: dict[str, set[str]], package: str, order: tuple[str, ...]
) -> None:
    upwards = [
        f"{name} imports {other}"
        for name, others in graph.items()
        for other in sorted(others)
        if name.split(".")[0] == package == other.split(".")[0]
        if other != package and name != package
        if floor(other, package, order) > floor(name, package, order)
    ]
    assert not upwards


def exported(init: Path) -> list[str]:
    """The names in `__all__` of a room: objects, and modules that other rooms may import."""
    for node in ast.parse(init.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return list(ast.literal_eval(node.value))
    return []


def test_rooms_use_only_exports_of_other_rooms(graph: dict[str, set[str]]) -> None:
    known = modules()
    exports = {n: set(exported(p)) for n, p in known.items() if p.name == "__init__.py"}
    used: dict[str, set[str]] = {name: set() for name in exports}
    for name, others in graph.items():
        for parts in (other.split(".") for other in others):
            depth = 1 if parts[0] == "meshes" else 2
            for k in range(depth, len(parts) if parts[:depth] != name.split(".")[:depth] else 0):
                used[".".join(parts[:k])].add(parts[k])
    for place, names in used.items():
        files = {n for n in exports[place] if f"{place}.{n}" in known}
        assert (place, names ^ files) == (place, set())


def test_the_packages_stand_above_each_other(graph: dict[str, set[str]]) -> None:
    allowed = {"solver": {"solver"}, "meshes": {"meshes"}, "contact_app": set(PACKAGES)}
    wrong = [
        f"{name} imports {other}"
        for name, others in graph.items()
        for other in others
        if other.split(".")[0] not in allowed[name.split(".")[0]]
    ]
    assert not wrong


def test_the_application_has_few_entries_at_its_top() -> None:
    entries = [p.name for p in (ROOT / "contact_app").iterdir() if p.name != "__pycache__"]
    assert len(entries) <= MOST_ENTRIES, sorted(entries)


def functions() -> Iterator[tuple[str, ast.FunctionDef]]:
    """Functions and methods with their names."""

    def within(prefix: str, node: ast.AST) -> Iterator[tuple[str, ast.FunctionDef]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef):
                yield prefix + child.name, child
            if isinstance(child, ast.ClassDef | ast.FunctionDef):
                yield from within(f"{prefix}{child.name}.", child)

    for name, path in modules().items():
        yield from within(f"{name}:", ast.parse(path.read_text(encoding="utf-8")))


def test_functions_are_of_a_screen_or_two() -> None:
    lengths = {name: (node.end_lineno or 0) - node.lineno + 1 for name, node in functions()}
    long = {name for name, length in lengths.items() if length > LONGEST}
    assert long == set(LONG)


def test_files_are_of_a_few_screens() -> None:
    lengths = {n: len(p.read_text(encoding="utf-8").splitlines()) for n, p in modules().items()}
    assert not {name for name, length in lengths.items() if length > LONGEST_FILE}


def test_functions_have_few_parameters() -> None:
    def count(node: ast.FunctionDef) -> int:
        found = node.args
        names = [a.arg for a in (*found.posonlyargs, *found.args, *found.kwonlyargs)]
        return len([n for n in names if n not in ("self", "cls")])

    many = {name for name, node in functions() if count(node) > MOST_PARAMETERS}
    assert many == set(MANY)


@pytest.mark.parametrize("record", TAKE_ALL)
def test_few_functions_take_the_whole_scene_or_model(record: str) -> None:
    def takes_all(node: ast.FunctionDef) -> bool:
        types = [a.annotation for a in (*node.args.args, *node.args.kwonlyargs) if a.annotation]
        return any(isinstance(n, ast.Name) and n.id == record for t in types for n in ast.walk(t))

    taking = {
        name
        for name, node in functions()
        if not name.startswith(("contact_app.scene", STUDIES))
        if takes_all(node)
    }
    assert len(taking) <= TAKE_ALL[record]


@pytest.mark.parametrize("package", NUMBERS_OUTSIDE_OF_RECORDS)
def test_tuned_numbers_stand_in_records(package: str) -> None:
    def is_tuned(node: ast.stmt) -> bool:
        if not isinstance(node, ast.Assign):
            return False
        values = [part.value for part in ast.walk(node.value) if isinstance(part, ast.Constant)]
        numbers = [value for value in values if isinstance(value, int | float)]
        return 0 < len(numbers) == len(values) and max(numbers) > 1e-7

    outside = [
        f"{name}:{node.lineno}"
        for name, path in modules().items()
        if name.startswith(package) and not name.startswith(STUDIES)
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if is_tuned(node)
    ]
    assert len(outside) <= NUMBERS_OUTSIDE_OF_RECORDS[package], outside


def test_tests_of_the_solver_import_the_solver_alone() -> None:
    for path in sorted((ROOT / "tests" / "solver").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [a.name for a in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                assert name.split(".")[0] not in ("contact_app", "meshes"), f"{path}: {name}"


def test_tests_stand_in_rooms_of_the_code() -> None:
    rooms = [p.parent for room in PACKAGES for p in (ROOT / "tests" / room).rglob("__init__.py")]
    assert not [room for room in rooms if not (ROOT / room.relative_to(ROOT / "tests")).is_dir()]


def test_only_tests_of_studies_name_studies() -> None:
    own = ROOT / "tests" / "contact_app" / "studies"

    def named(node: ast.AST) -> str:
        if isinstance(node, ast.ImportFrom):
            return node.module or ""
        return str(node.value).replace("/", ".") if isinstance(node, ast.Constant) else ""

    wrong = [
        str(path.relative_to(ROOT))
        for path in sorted((ROOT / "tests").rglob("*.py"))
        if own not in path.parents and path != Path(__file__)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if STUDIES in named(node)
    ]
    assert not wrong


def private(node: ast.AST) -> str:
    """Private name of another module that a piece of a test reads or patches."""

    def hidden(name: str) -> bool:
        return name.startswith("_") and not name.startswith("__")

    if isinstance(node, ast.ImportFrom):
        return next((a.name for a in node.names if hidden(a.name)), "")
    if isinstance(node, ast.Attribute) and hidden(node.attr):
        own = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
        return "" if own else node.attr
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        texts = [a.value for a in node.args if isinstance(a, ast.Constant)]
        last = [str(text).rsplit(".", 1)[-1] for text in texts]
        patched = [name for name in last if hidden(name) or name.isupper()]
        return patched[0] if patched and node.func.attr == "setattr" else ""
    return ""


def test_tests_use_public_names_and_patch_no_constants() -> None:
    wrong = [
        f"{path.relative_to(ROOT)}:{node.lineno} {private(node)}"  # type: ignore[attr-defined]
        for path in sorted((ROOT / "tests").rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if private(node)
    ]
    assert not wrong


def limits_of_work(node: ast.FunctionDef) -> list[str]:
    """Comparisons of a function by which operator applications or iterations are not the larger."""
    return [
        ast.unparse(part)
        for part in ast.walk(node)
        if isinstance(part, ast.Compare)
        for left, sign, right in zip(
            [part.left, *part.comparators], part.ops, part.comparators, strict=False
        )
        if isinstance(sign, ast.Lt | ast.LtE | ast.Gt | ast.GtE)
        for smaller in (left if isinstance(sign, ast.Lt | ast.LtE) else right,)
        if re.search(r"hessian|applications|counts\.(cg|inner|outer)", ast.unparse(smaller))
    ]


def test_tests_that_limit_work_are_marked_as_ratchets() -> None:
    unmarked = [
        f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"
        for path in sorted((ROOT / "tests").rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef) and limits_of_work(node)
        if not any("ratchet" in ast.unparse(mark) for mark in node.decorator_list)
    ]
    assert not unmarked


def docstrings(path: Path) -> Iterator[tuple[int, str]]:
    """Lines and texts of docstrings, those below constants included."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            yield node.lineno, str(node.value.value)


def test_docstrings_begin_with_the_name_of_a_thing() -> None:
    unclear = [
        f"{path.relative_to(ROOT)}:{line} {text.splitlines()[0]}"
        for package in (*PACKAGES, "tests")
        for path in sorted((ROOT / package).rglob("*.py"))
        for line, text in docstrings(path)
        if text.startswith(UNCLEAR)
    ]
    assert not unclear


def test_long_functions_of_the_application_have_a_docstring() -> None:
    silent = [
        name
        for name, node in functions()
        if name.startswith("contact_app") and not name.startswith(STUDIES)
        if not ast.get_docstring(node) and not node.name.startswith("__")
        if (node.end_lineno or 0) - node.lineno > LONGEST_WITHOUT_DOCSTRING
    ]
    assert not silent


def test_prose_has_no_riddles() -> None:
    pages = [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", ROOT / "solver" / "README.md"]
    prose = [(page, 1, page.read_text(encoding="utf-8")) for page in sorted(pages)]
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            prose += [(path, line, text) for line, text in docstrings(path)]
    found = [
        f"{path.relative_to(ROOT)}:{line} {phrase}"
        for path, line, text in prose
        for phrase in RIDDLES
        if phrase in " ".join(text.split())
    ]
    assert not found


def test_the_changelog_has_each_part_and_point_of_a_release_once() -> None:
    """Parts of a release and the beginnings of their points."""
    _, *releases = re.split(
        r"^## ", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.M
    )
    repeated = []
    for release in releases:
        begun = re.findall(r"^(?:### \w+|- .{,60})", release, flags=re.MULTILINE)
        repeated += [
            f"{release.split()[0]}: {line}" for line in set(begun) if begun.count(line) > 1
        ]
    assert not repeated


def unclear_words(path: Path) -> set[str]:
    """Words that are no names in the rooms of a file; empty outside them."""
    rooms = [words for place, words in PLAIN.items() if (ROOT / place) in path.parents]
    return PRIVATE_NAMES.union(*rooms) if rooms else set()


def test_names_are_terms_of_the_field() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno} {name}"  # type: ignore[attr-defined]
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        for words in (unclear_words(path),)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        for name in (defined(node),)
        if name.strip("_") in words
    ]
    assert not found


def test_names_of_tests_describe_the_program() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"
        for path in sorted((ROOT / "tests").rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
        if UNCLEAR_IN_TESTS & set(node.name.split("_"))
    ]
    assert not found


def defined(node: ast.AST) -> str:
    """Name that a piece of code gives to something."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return node.name
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        return node.id
    if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
        return node.attr
    return node.arg if isinstance(node, ast.arg) else ""


def documented(node: ast.ClassDef | ast.FunctionDef) -> Iterator[str]:
    """Names above the descriptions in the sections "Attributes" and "Parameters"."""
    lines = (ast.get_docstring(node) or "").splitlines()
    within = False
    for line, following in pairwise([*lines, ""]):
        if following and not following.strip("-"):
            within = line in ("Attributes", "Parameters")
        elif within and line and not line.startswith(" ") and line.strip("-"):
            yield from (name.strip(" *") for name in line.split(" : ")[0].split(","))


def documentable(node: ast.ClassDef | ast.FunctionDef) -> set[str]:
    """Parameters of a function; fields, attributes, methods and parameters of a class."""
    if isinstance(node, ast.FunctionDef):
        return {child.arg for child in ast.walk(node.args) if isinstance(child, ast.arg)}
    found = {child.name for child in node.body if isinstance(child, ast.FunctionDef)}
    for child in ast.walk(node):
        if isinstance(child, ast.arg):
            found.add(child.arg)
        if isinstance(child, ast.Name | ast.Attribute) and isinstance(child.ctx, ast.Store):
            found.add(child.id if isinstance(child, ast.Name) else child.attr)
    return found


def definitions() -> Iterator[tuple[Path, ast.ClassDef | ast.FunctionDef]]:
    """All classes and functions of the packages, with their files."""
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ClassDef | ast.FunctionDef):
                    yield path, node


def called(decorator: ast.expr) -> str:
    """Name of a decorator without its arguments."""
    return ast.unparse(decorator.func if isinstance(decorator, ast.Call) else decorator)


def test_records_are_immutable() -> None:
    changing = {
        node.name
        for _, node in definitions()
        for decorator in node.decorator_list
        if called(decorator) == "dataclass" and "frozen=True" not in ast.unparse(decorator)
    }
    assert changing == set(CHANGING)


def test_documented_parameters_exist() -> None:
    wrong = [
        f"{path.relative_to(ROOT)}:{node.lineno} {name}"
        for path, node in definitions()
        for name in set(documented(node)) - documentable(node)
    ]
    assert not wrong


def test_records_describe_their_fields_below_each() -> None:
    wrong = [
        f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"
        for path, node in definitions()
        if isinstance(node, ast.ClassDef) and "dataclass" in map(called, node.decorator_list)
        if "\nAttributes\n" in (ast.get_docstring(node) or "")
    ]
    assert not wrong


def test_each_documented_parameter_begins_a_line() -> None:
    joined = re.compile(r"\.\s+(\w+)( : \(.*)?$", re.MULTILINE)
    wrong = [
        f"{path.relative_to(ROOT)}:{node.lineno} {match[1]}"
        for path, node in definitions()
        for match in joined.finditer(ast.get_docstring(node) or "")
        if match[1] in documentable(node) - set(documented(node)) and list(documented(node))
    ]
    assert not wrong
