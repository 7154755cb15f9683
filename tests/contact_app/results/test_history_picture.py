"""The picture of a load history."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

import contact_app
from contact_app.results.plot.history_picture import HistoryError, draw_history, panels, read_table
from contact_app.results.plot.picture import plot
from contact_app.results.plot.stored import StoredError, read
from contact_app.run.result_directory import clear
from tests import scenes

HEAD = "increment,step,factor,time,factor_press,energy,max_displacement,dissipated_work"
ROWS = ("1,1,1.0,1.0,1.0,-1.0,0.1,0.0", "2,2,1.0,2.0,1.0,-1.0,0.2,0.5")


def table(path: Path, *more: str) -> Path:
    """A table of two increments; more columns are empty in the first."""
    head, (one, two) = ",".join([HEAD, *more]), ROWS
    path.write_text("\n".join([head, one + "," * len(more), two + ",3.0" * len(more)]) + "\n")
    return path


def test_missing_entries_of_a_row_are_zero(tmp_path: Path) -> None:
    columns = read_table(table(tmp_path / "increments.csv", "tip_x"))
    assert columns["time"] == [1.0, 2.0]
    assert columns["tip_x"] == [0.0, 3.0]


def test_each_kind_of_column_has_a_panel(tmp_path: Path) -> None:
    """The picture grows by a panel for forces and one for statuses; probes take one that was."""
    heights = []
    for more in (
        [],
        ["tip_x"],
        ["contacts[0]_force_x"],
        ["contacts[0]_force_x", "contacts[0]_stick"],
    ):
        made = draw_history(table(tmp_path / "increments.csv", *more), tmp_path / "history.png")
        picture = imread(made)
        heights.append(len(picture))
        assert picture[..., :3].std() > 0.05
    assert heights[0] == heights[1] < heights[2] < heights[3]


@pytest.mark.parametrize(
    "text", ["", HEAD, "a,b\n1,2\n", f"{HEAD}\n{ROWS[0].replace('0.1', 'x')}\n"]
)
def test_files_without_a_table_are_reported(text: str, tmp_path: Path) -> None:
    (tmp_path / "increments.csv").write_text(text)
    with pytest.raises(HistoryError, match=r"increments.csv is no table of increments"):
        draw_history(tmp_path / "increments.csv", tmp_path / "history.png")


def test_plot_draws_it(tmp_path: Path) -> None:
    made = scenes.wall("quadrilateral", 3)
    made["conditions"][1]["name"] = "load"
    made["steps"] = [{"load": 1, "increments": 2}]
    contact_app.solve(made).write(tmp_path)
    pictures, _ = plot(tmp_path)
    assert tmp_path / "history.png" in pictures
    clear(tmp_path, resume=False)
    assert not list(tmp_path.iterdir())


def test_pictures_of_an_earlier_increment(tmp_path: Path) -> None:
    """Half of a displacement, before anything touches."""
    made = scenes.wall("quadrilateral", 3)
    del made["contacts"], made["conditions"][1:]
    made["conditions"].append({"name": "up", "on": "block.y+", "displacement": [0, 0.1]})
    made["steps"] = [{"up": 1, "increments": 2}]
    contact_app.solve(made).write(tmp_path)
    largest = [
        float(np.abs(read(tmp_path, time).point_data["displacement"][:, 1]).max())
        for time in (0.5, 1.0, None)
    ]
    assert largest == pytest.approx([0.05, 0.1, 0.1])
    pictures, _ = plot(tmp_path, output=tmp_path / "half", time=0.5, fields=("von_mises",))
    assert [path.name for path in pictures] == ["bodies.png", "history.png"]
    with pytest.raises(StoredError, match=r"no increment at the time 0.7; it has 0.5, 1"):
        plot(tmp_path, time=0.7)


def test_nodes_in_contact_without_friction_do_not_count_as_slipping(tmp_path: Path) -> None:
    with_friction = read_table(table(tmp_path / "increments.csv", "contacts[0]_slip"))
    assert list(panels(with_friction)["nodes"]) == ["contacts[0] slip"]
    del with_friction["dissipated_work"]
    assert list(panels(with_friction)["nodes"]) == ["contacts[0] in contact"]
