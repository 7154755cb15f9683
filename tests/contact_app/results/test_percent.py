"""Shares as text."""

import pytest

from contact_app.results.percent import percent


@pytest.mark.parametrize(
    ("share", "text"),
    [(2.6e-4, "0.026 %"), (0.174, "17 %"), (0.994, "99 %"), (0.999, "100 %"), (1.742, "174 %")],
)
def test_no_share_is_written_as_a_power_of_ten(share: float, text: str) -> None:
    assert percent(share) == text
