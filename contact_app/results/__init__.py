"""What is said of an answer: forces, pressures and areas of contact.

Input is a solved `Model` with its `Solution`. The nodal forces of the contact rows are divided
among the contacts (`division`), `contact_app.pressure` makes the pressure of each contact from
them, and `contacts` sums them up for ``summary.json`` and hands them to ``solution.xdmf``, of the
whole where the scene was cut at planes of symmetry.
"""
