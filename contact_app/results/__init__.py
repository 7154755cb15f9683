"""The results of an answer: fields, contact pressures, forces and areas, files and pictures.

Input is a solved `Model` with its `Solution`. `fields` are the values at nodes and cells. The nodal
forces of the contact rows are divided among the contacts (`division`), `pressure` makes the
pressure of each contact from them, and `contacts` sums them up for ``summary.json``. `mirror`
completes a scene that was cut at planes of symmetry. `xdmf`, `report` and `history` write the
files, `plot` draws them.
"""
