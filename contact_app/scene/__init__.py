"""A scene: bodies, materials, conditions and contacts by name, numbers checked; it knows no mesh.

Input is a YAML file or a mapping of the same keys: `yaml_reader` keeps the line of each key,
`schema` has the sections of the file, `configuration` reads and checks a whole one, `overrides`
carries out ``--set``, `expressions` reads arithmetic in x, y and z. The product is a
`scene.Scene`, whose records stand in `bodies`, `material`, `obstacles` and `conditions`.
`build.build_scene` resolves names and checks numbers; its errors name file, line, key and what is
allowed.
"""
