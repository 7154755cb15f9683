"""Sections of the scene file as typed by the user; every key is documented here.

Input is a mapping from a YAML file or from Python; the product is the same content as checked
models of pydantic, or errors that name the key and the allowed values. The models define the schema
(``contact-app schema``), and their descriptions are the manual. They check types and ranges. Checks
of several keys (names, dimensions) follow when the scene is built (`contact_app.scene.build`).
`base` has the types of numbers, `bodies` the sections of bodies and materials, `conditions` those
of conditions, contacts and load steps, `options` those of the solver, the certificate and output.
"""

__all__ = ["bodies"]
