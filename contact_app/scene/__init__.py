"""A scene: bodies, materials, conditions and contacts with resolved names and checked numbers.

Input is a YAML file or a mapping of the same keys: `yaml_reader` stores the line of each key,
`schema` has the sections of the file, `configuration` reads and checks a file, `overrides` applies
``--set``, and `expressions` parses arithmetic in x, y and z. The product is a `scene.Scene`; its
records are defined in `bodies`, `material`, `obstacles` and `conditions`. It is independent of
meshes. `build.build_scene` resolves names and checks numbers; its errors name file, line, key and
what is allowed.
"""

__all__ = [
    "bodies", "build", "conditions", "configuration", "finer_meshes", "material", "obstacles",
    "read_conditions", "rigid", "scene", "schema", "yaml_reader",
]  # fmt: skip
