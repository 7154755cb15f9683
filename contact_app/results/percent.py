"""Shares in percent, as text for users."""


def percent(share: float) -> str:
    """A share with two digits, or all digits before the point: "0.026 %", "17 %", "174 %"."""
    value = 100.0 * share
    return f"{value:.0f} %" if 99.5 <= abs(value) < 1e6 else f"{value:.2g} %"
