"""The configuration: every wrong file gives readable messages with file, line and key."""

import copy
import json
import random
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from contact_app.errors import ConfigurationError
from contact_app.scene import yaml_reader
from contact_app.scene.configuration import Configuration, load
from contact_app.scene.schema.options import EXPANSIONS, FIELDS, Solver
from solver.contact.options import SolverOptions
from solver.qp.expansion import expansion_names
from tests import scenes

SCENE = """\
title: cube
dimension: 3
bodies:
  - name: cube
    mesh: {box: {lower: [0, 0, 0], upper: [1, 1, 1], cells: [2, 2, 2], cell: hexahedron}}
    material: {young: 2.0e5, poisson: 0.33}
    boundaries:
      foot: {where: "z < 1e-9"}
conditions:
  - {on: cube.foot, displacement: [0, 0, 0]}
  - {on: cube.z+, traction: [0, 0, -465]}
contacts:
  - {on: cube.x+, obstacle: {plane: {point: [1, 0, 0], normal: [-1, 0, 0]}}}
"""
BOX = "bodies.0.mesh.box"
PLANE = "contacts.0.obstacle.plane"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "cube.yaml"
    path.write_text(SCENE)
    return path


def refused(path: Path, *overrides: str) -> str:
    """Message of a refusal; fails where there is none."""
    with pytest.raises(ConfigurationError) as caught:
        scenes.read(path, overrides)
    return str(caught.value)


def test_numbers_of_yaml_1_2_reach_the_scene(file: Path) -> None:
    scene = scenes.read(file, ["bodies.0.material.young=2E5", f"{BOX}.upper=[1e-3, .5, 2]"])
    assert scene.bodies[0].materials[0].young == 200_000.0
    assert scene.bodies[0].mesh.upper == (0.001, 0.5, 2)


def test_defaults_equal_the_manual(file: Path) -> None:
    scene = scenes.read(file)
    assert scene.solver.tolerance == 1e-6
    assert scene.solver == SolverOptions()
    assert scene.output.xdmf
    assert scene.decomposition.subdomains is None
    assert [b.degree for b in scene.bodies] == [1]


# Where the message is, which key it names, and what it says.
WRONG = [
    # keys
    ("bodis=3", "bodis is an unknown key; did you mean bodies?"),
    ("bodies.0.meterial={}", "bodies[0].meterial is an unknown key; did you mean material?"),
    ("conditions.0.dispalcement=[0,0,0]", "did you mean displacement?"),
    ("contacts.0.obstacle={cone: {}}", "allowed: plane, sphere, cylinder"),
    ("contacts.0.obstacle={sphere: {centre: [2,0,0], radius: 1}}", "did you mean center?"),
    ("contacts.0.obstacle={sphere: {center: [2,0,0]}}", "sphere.radius is missing"),
    ("bodies.0.material={}", "bodies[0].material.young is missing"),
    ("solver.maxit=4", "did you mean max_iterations?"),
    # types
    (f"{BOX}.cells=10", "cells is 10; a list is allowed"),
    (f"{BOX}.cells=[1.5,1,1]", "cells[0] is 1.5; a whole number is allowed"),
    (f"{BOX}.cells=[true,1,1]", "cells[0] is True; a whole number is allowed"),
    ("bodies.0.material.young=true", "young is True; a number is allowed"),
    ("bodies.0.material.young=stiff", "young is 'stiff'; a number is allowed"),
    ("bodies.0.material.young='2e5'", "is '2e5'; a number is allowed; write it without quotes"),
    ("bodies.0.material.young=210 GPa", "a number is allowed; write it without a unit"),
    ("bodies.0.material.young=210_000", "write it in digits alone"),
    ("bodies.0.material={young: 2,1e5, poisson: 0.3}", "1e5 is an unknown key; a comma begins a"),
    ("conditions.1={on: cube.z+, traction: 0, 0, -1}", "0 is an unknown key; a comma begins a new"),
    ("bodies.0.material=5", "material is 5; a mapping is allowed, with the keys young, poisson"),
    ("bodies.0.mesh=", "mesh is empty; a mapping is allowed"),
    ("bodies.0.name=5", "name is 5; text is allowed"),
    ("bodies={}", "bodies is {}; a list is allowed"),
    ("bodies=", "bodies is empty; a list is allowed"),
    ("bodies=[3]", "bodies[0] is 3; a mapping is allowed, with the keys name, mesh"),
    ("conditions.0.displacement=[a,b,c]", "displacement[1] is 'b'; a number is allowed"),
    ("output.xdmf=yes", "xdmf is 'yes'; true or false is allowed"),
    ("title=5", "title is 5; text is allowed"),
    ('title="\\x1b[31m"', "one line of printable text is allowed"),
    ('title="\\ud800"', "one line of printable text is allowed"),
    # lengths
    (f"{BOX}.cells=[10,10]", "cells has 2 numbers; a box in 3D has 3"),
    (f"{BOX}.upper=[1,1]", "upper has 2 components; a corner in 3D has 3"),
    ("conditions.0.displacement=[0,0]", "displacement has 2 components; in 3D it has 3"),
    ("conditions.1.traction=[0,0]", "traction has 2 components"),
    (f"{PLANE}.normal=[1,0]", "normal has 2 components; a direction in 3D has 3"),
    ("bodies=[]", "must not be empty"),
    ("conditions.0.displacement=[0,0,0,0]", "at most 3 items"),
    ("dimension=2", "cube.yaml:5: bodies[0].mesh.box.lower has 3 components; a corner in 2D has 2"),
    # numbers
    (f"{BOX}.upper=[.nan,1,1]", "upper[0] is nan; a finite number is allowed"),
    (f"{BOX}.upper=[-.inf,1,1]", "upper[0] is -inf; a finite number is allowed"),
    (f"{BOX}.upper=[1e999,1,1]", "upper[0] is inf; a finite number is allowed"),
    (f"{BOX}.upper=[1e300,1,1]", "it must be at most 1e+50"),
    ("conditions.1.traction=[0,0,-1e300]", "it must be at least -1e+50"),
    ("bodies.0.material.young=-1", "young is -1; it must be at least 1e-50, that is above 0"),
    ("bodies.0.material.young=0", "above 0"),
    ("bodies.0.material.poisson=0.5", "needs -1 < ν < 0.5"),
    ("bodies.0.material.poisson=-1", "needs -1 < ν < 0.5"),
    ("bodies.0.material.poisson=2", "needs -1 < ν < 0.5"),
    ("bodies.0.material.poisson=0.4999999999", "round-off would decide"),
    ("solver.tolerance=0", "tolerance is 0; it must be at least 1e-14"),
    ("solver.tolerance=2", "it must be below 1"),
    ("solver.tolerance=automatic", "allowed: auto, or a number from 1e-14 to 1"),
    ("solver.alpha_u=3", "it must be at most 2"),
    ("solver.gamma=-1", "above 0"),
    ("solver.max_iterations=0", "it must be at least 1"),
    ("solver.max_iterations=1e3", "a whole number is allowed"),
    # boxes
    (f"{BOX}.cells=[10,10,0]", "cells[2] is 0; it must be at least 1"),
    (f"{BOX}.upper=[0,1,1]", "not above lower (0): the box has no volume"),
    (f"{BOX}.upper=[1,-1,1]", "is -1 along y"),
    (f"{BOX}.upper=[1e-9,1,1]", "times as long as wide"),
    (f"{BOX}.upper=[1e-20,1e-20,1e-20]", "choose a smaller unit of length"),
    (f"{BOX}.cells=[99999999999999999999,1,1]", "too small along x"),
    (f"{BOX}.cells=[100000,100000,100000]", "degrees of freedom in all, which need about"),
    (f"{BOX}.cell=hexahedra", "did you mean hexahedron?"),
    (f"{BOX}.cell=triangle", "in 3D hexahedron or tetrahedron is allowed"),
    ("bodies.0.mesh={}", "needs `box:"),
    ("bodies.0.mesh.file=part.msh", "bodies[0].mesh has both; exactly one of `box"),
    ("bodies.0.degree=3", "allowed: 1 or 2"),
    ("bodies.0.material={steel: {young: 1, poisson: 0.3}}", "by tag needs a mesh from a file"),
    # names
    ("bodies.0.name=a.b", "or _ first, then these, digits and - are allowed"),
    ("bodies.1={name: cube, mesh: {box: {lower: [0,0,0], upper: [1,1,1], cells: [1,1,1]}}, "
     "material: {young: 1, poisson: 0}}", "bodies[1].name is 'cube', the name of an earlier body"),
    ("conditions.0.on=cub.z-", "names the body 'cub'; did you mean cube?"),
    ("conditions.0.on=cube.foots", "did you mean cube.foot?"),
    ("conditions.0.on=cube.w", "(known: x-, x+, y-, y+, z-, z+, foot)"),
    ("conditions.0.on=cube", "it has the form body.boundary"),
    ("contacts.0.on=cube.nose", "contacts[0].on names the boundary 'nose'"),
    ("bodies.0.boundaries.x-.where=x<1", "redefines x-"),
    ("bodies.0.boundaries.1.where=x<1", "is no name for a boundary"),
    ("bodies.0.boundaries.foot.where=x", "a number, not a condition"),
    ("bodies.0.boundaries.foot.where=(x - 1)^2 < 4", "write ** for a power"),
    ("bodies.0.boundaries.foot.where=__import__('os')", "which is not allowed; allowed: numbers"),
    ("bodies.0.boundaries.foot=x<1", "a mapping is allowed, with the keys where"),
    # conditions and contacts
    ("conditions.0.traction=[0,0,1]", "conditions[0] has displacement and traction; exactly one"),
    ("conditions.1={on: cube.z+}", "conditions[1] has no kind; exactly one"),
    ("conditions.1={on: cube.z+, force: [0,0,1]}", "a force acts `in` a body"),
    ("conditions.1={in: cube, traction: [0,1,0]}", "a traction acts `on` a boundary"),
    ("conditions.0.displacement=[null,null,null]", "leaves every component free"),
    ("conditions.1.traction=[0,0,0]", "load nothing"),
    ("conditions=[]", "load nothing"),
    ("contacts.0.against=cube.x-", "has both; needs an `obstacle`"),
    ("contacts.0={on: cube.x+, against: cube.x-}", "is a boundary of cube itself"),
    ("contacts.0={on: cube.x+, against: ball.x-}", "contacts[0].against names the body 'ball'"),
    ("contacts.0={on: cube.x+, against: cube}", "it has the form body.boundary"),
    ("contacts.0={on: cube.x+}", "needs an `obstacle`"),
    ("contacts.0.obstacle={}", "has no shape; exactly one"),
    ("contacts.0.obstacle.sphere={center: [2,0,0], radius: 1}", "has plane and sphere"),
    ("contacts.0.obstacle={sphere: {center: [3,0,0], radius: -1}}", "sphere.radius is -1"),
    (f"{PLANE}.normal=[0,0,0]", "is zero, which is no direction"),
    ("contacts.0.obstacle={cylinder: {point: [3,0,0], axis: [0,0,0], radius: 1}}", "is zero"),
    # choices
    ("dimension=4", "dimension is 4; allowed: 3, 2, plane_strain, plane_stress"),
    ("dimension=3.0", "dimension is 3.0; allowed: 3, 2"),
    ("dimension=true", "dimension is True; allowed: 3, 2"),
    ("dimension=axisymmetric", "plane_stress; a body of revolution is drawn in 3D"),
    ("conditions.1={in: cube, weight: [0,0,-1]}", "the weight of a body is a condition {in: body"),
    ("gravity=[0,0,-9.81]", "the weight of a body is a condition {in: body, force: [0, 0, -ρg]}"),
    ("bodies.0.material.density=7.8e-9", "density is an unknown key; the weight of a body is"),
    ("decomposition=5", "allowed: auto or {subdomains: N | [nx, ny, nz]}"),
    ("decomposition={subdomains: 0}", "a whole number from 1 on"),
    ("decomposition={subdomains: [1,2]}", "has 2 numbers; along the axes of 3D there are 3"),
    ("decomposition={subdomains: [1,2,9]}", "9 sub-boxes along z, where cube has 2 cells"),
    ("decomposition={subdomains: 9}", "at most one per cell is allowed, 8 here"),
    ("solver.expansion=projgc", "did you mean projcg?"),
    ("output.vtu=maybe", "true or false is allowed"),
    ("accuracy=0", "it must be at least"),
    ("output.fields=[stres]", "did you mean stress?"),
    # --set itself
    ("title", "the form path.to.key=value is allowed"),
    ("=3", "the form path.to.key=value is allowed"),
    ("a..b=3", "the form path.to.key=value is allowed"),
    ("bodies.7.name=a", "bodies is a list of length 1; give the number of an item"),
    ("bodies.first.name=a", "bodies is a list of length 1; give the number of an item"),
    ("bodies.²=4", "bodies is a list of length 1; give the number of an item"),
    (f"{BOX}.lower=[1", "not YAML"),
    ("title=&a b", "anchors and aliases"),
    (".".join("a" * 100) + "=1", "nested deeper"),
]  # fmt: skip


@pytest.mark.parametrize(("override", "expected"), WRONG, ids=[text[:50] for text, _ in WRONG])
def test_wrong_values_are_refused(file: Path, override: str, expected: str) -> None:
    message = refused(file, override)
    assert expected in message
    assert "\n\n" not in message
    assert message.startswith(("--set ", str(file)))
    assert "Traceback" not in message
    assert "pydantic" not in message


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("poisson: 0.33", "poisson: 0.5", "cube.yaml:6: bodies[0].material.poisson is 0.5"),
        ("  - name: cube", "  - nmae: cube", "cube.yaml:4: bodies[0].nmae is an unknown key"),
        ("title: cube", "title: cube\ntitle: again", "cube.yaml:2: title is given twice"),
        ("cube.z+", "cube.zz", "cube.yaml:11: conditions[1].on names the boundary 'zz'"),
        ("[-1, 0, 0]", "[0, 0, 0]", "cube.yaml:13: contacts[0].obstacle.plane.normal is zero"),
        ("z < 1e-9", "z.real", "cube.yaml:8: bodies[0].boundaries.foot.where uses `z.real`"),
        ("dimension: 3", "", "cube.yaml:1: dimension is missing in the file"),
        ("title: cube", "title: cube: again", "cube.yaml:1: this is not YAML: mapping values"),
        ("title: cube", "title: cube: again", "put text that contains a colon in quotes"),
        ("normal: [-1, 0, 0]", "normal: [-1, 0, 0", "a bracket or a quote is not closed"),
        ("title: cube", "title cube", "see whether the line before lacks its colon"),
        ("poisson: 0.33}", "poisson: 0.33", "cube.yaml:7: this is not YAML: expected ',' or '}'"),
        ("poisson: 0.33}", "poisson: 0.33", "not closed, or a comma is missing (after line 6)"),
        ("young: ", "E: ", "material.E is an unknown key; Young's modulus is young; allowed"),
        ("displacement: [0, 0, 0]", "displacement: 0", "a list is allowed, with a number for each"),
        (
            "traction: [",
            "force: [",
            "a force acts `in` a body, e.g. {in: cube, force: [0, 0, -1]}; "
            "on a boundary there are traction, pressure and total_force",
        ),
        ("title: cube", "title: cube\nsteps: 3", "steps is 3; a list is allowed, with a dash"),
        ("cube.z+", "foot", "conditions[1].on is 'foot'; it has the form body.boundary, e.g."),
    ],
)
def test_messages_name_file_line_and_key(file: Path, old: str, new: str, expected: str) -> None:
    assert old in SCENE
    file.write_text(SCENE.replace(old, new, 1))
    assert expected in refused(file)


def test_all_problems_of_a_file_are_reported_together(file: Path) -> None:
    message = refused(file, "title=5", "solver.tolerance=x", f"{BOX}.cells=[0,1,1]")
    assert len(message.splitlines()) == 3


@pytest.mark.parametrize("text", ["- a\n- b\n", "hello\n", "3\n", "null\n"])
def test_a_file_that_is_no_mapping(file: Path, text: str) -> None:
    file.write_text(text)
    assert str(file) in refused(file)


def test_overrides_make_mappings_and_replace_scalars(file: Path) -> None:
    assert load(file, ["decomposition.subdomains=[1, 2, 2]"]).decomposition != "auto"
    assert load(file, ["solver.tolerance=1e-3"]).solver.tolerance == 1e-3
    added = load(file, ["conditions.2={in: cube, force: [0, 0, -1]}"])
    assert len(added.conditions) == 3
    assert load(file, ["title=a=b"]).title == "a=b"
    assert load(file, ["title=one", "title=two"]).title == "two"


def test_overrides_name_items_as_messages_do(file: Path) -> None:
    message = refused(file, "bodies[0].material.poisson=0.7")
    assert message.startswith("--set bodies[0].material.poisson=0.7: bodies[0].material.poisson is")
    assert load(file, ["bodies[0].mesh.box.cells[1]=5"]).bodies[0].mesh.box.cells == [2, 5, 2]


@pytest.mark.parametrize(
    ("overrides", "to_blame"),
    [
        (["title.x.y=3"], 0),  # replaces the text on the way
        (["conditions.0.on.a=3"], 0),
        (["bodies.1.mesh.box.cells=[1,1,1]"], 0),  # makes a body without a name
        (["spin.speed=3"], 0),
        (["solver.tolerance=1e-3", "solver={tolerance: 7}"], 1),  # the later one counts
        (["solver={tolerance: 7}", "solver.gamma=2"], 0),
        (["decomposition.subdomains=0", "title=x"], 0),
    ],
)
def test_the_wrong_override_is_named(file: Path, overrides: list[str], to_blame: int) -> None:
    for line in refused(file, *overrides).splitlines():
        assert line.startswith(f"--set {overrides[to_blame]}: ")


@pytest.mark.parametrize("key", [r"a\nb", r"a\u2028b"])
def test_a_message_stays_on_its_line_for_keys_with_line_breaks(file: Path, key: str) -> None:
    file.write_text(f'{SCENE}"{key}": 1\n')
    message = refused(file)
    assert len(message.splitlines()) == 1
    assert f"cube.yaml:14: {key} is an unknown key" in message


def test_expansions_equal_those_of_the_solver() -> None:
    assert set(EXPANSIONS) == set(expansion_names())


def test_every_key_of_the_schema_is_described() -> None:
    schema = Configuration.model_json_schema(by_alias=True)
    sections = {"scene": schema, **schema["$defs"]}
    undescribed = [
        f"{name}.{key}"
        for name, section in sections.items()
        for key, value in section.get("properties", {}).items()
        if not value.get("description")
    ]
    assert undescribed == []
    assert all(s.get("description") for s in sections.values())
    assert schema["properties"]["dimension"]["enum"] == [3, 2, "plane_strain", "plane_stress"]
    json.dumps(schema)


def test_configuration_and_scene_need_no_heavy_imports() -> None:
    code = (
        "import sys, contact_app.cli, contact_app.scene.configuration, contact_app.scene.build;"
        "print([m for m in ('dolfinx', 'petsc4py', 'mpi4py', 'scipy', 'matplotlib') "
        "if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True, text=True, timeout=60, check=True,
        cwd=Path(__file__).parents[3],
    )  # fmt: skip
    assert done.stdout.strip() == "[]"


# --- garbage -----------------------------------------------------------------------------------

JUNK = st.recursive(
    st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8),
        st.sampled_from(["cube.x+", "cube", "auto", "projcg", "z < 1", 1e308, -1, 0, 10**25]),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(
            st.one_of(st.text(max_size=5), st.sampled_from(["box", "plane", "where", "young"])),
            inner, max_size=3,
        ),
    ),
    max_leaves=6,
)  # fmt: skip


def places(data: Any, path: tuple = ()) -> list[tuple]:
    """All paths into a nested value."""
    items = (
        data.items()
        if isinstance(data, dict)
        else enumerate(data)
        if isinstance(data, list)
        else ()
    )
    return [path, *(p for key, value in items for p in places(value, (*path, key)))]


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32), st.lists(JUNK, min_size=1, max_size=3))
def test_random_mutations_are_scenes_or_refused(
    tmp_path_factory: pytest.TempPathFactory, seed: int, junk: list[Any]
) -> None:
    chance = random.Random(seed)
    data = copy.deepcopy(yaml.safe_load(SCENE))
    for value in junk:
        path = chance.choice(places(data)[1:] or [("title",)])
        target = data
        for key in path[:-1]:
            target = target[key]
        action = chance.choice(["replace", "delete", "add"])
        if action == "delete":
            del target[path[-1]]
        elif action == "add" and isinstance(target, list):
            target.append(value)
        else:
            target[path[-1]] = value
    file = tmp_path_factory.getbasetemp() / "mutant.yaml"
    file.write_text(yaml.dump(data, allow_unicode=True), encoding="utf-8", errors="replace")
    expected = ""
    try:
        scenes.read(file)
    except ConfigurationError as error:
        expected = str(error)
    assert not expected or expected.startswith(str(file))


@settings(max_examples=100, deadline=None)
@given(st.sampled_from(places(yaml.safe_load(SCENE))[1:]), st.text(max_size=30))
def test_random_overrides_are_scenes_or_refused(
    tmp_path_factory: pytest.TempPathFactory, path: tuple, value: str
) -> None:
    file = tmp_path_factory.getbasetemp() / "overridden.yaml"
    file.write_text(SCENE)
    expected = "--set"
    try:
        scenes.read(file, [".".join(map(str, path)) + "=" + value])
    except ConfigurationError as error:
        expected = str(error)
    assert expected.startswith(("--set", str(file)))


# --- the manual --------------------------------------------------------------------------------

MANUAL = (Path(__file__).parents[3] / "docs" / "guide" / "scenes.md").read_text()


def test_the_manual_names_every_key() -> None:
    schema = Configuration.model_json_schema(by_alias=True)
    keys = {key for section in (schema, *schema["$defs"].values()) for key in section["properties"]}
    words = set(re.findall(r"[a-z_]+", MANUAL))
    assert keys - words == set()
    for choice in (*EXPANSIONS, *FIELDS):
        assert f"`{choice}`" in MANUAL


def test_the_manual_s_scene_is_a_scene(file: Path) -> None:
    file.write_text(re.findall(r"```yaml\n(.*?)```", MANUAL, flags=re.DOTALL)[0])
    scene = scenes.read(file)
    assert scene.title == "cube pressed beside a rigid wall"


def test_the_manual_gives_the_defaults() -> None:
    defaults = Solver.model_validate({})
    for key in Solver.known_keys():
        row = next(line for line in MANUAL.splitlines() if line.startswith(f"| `{key}` |"))
        given = yaml_reader.scalar(row.split("|")[2].strip(" `"), "manual")
        assert given == getattr(defaults, key)
