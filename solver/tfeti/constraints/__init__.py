"""The rows of B: gluing, held nodes and contact, and products with them on all ranks.

`rows` writes them, `cross_points` glues nodes of many subdomains, `exchange` lets the copies of a
node meet at the rank that owns it, `matrix` is B itself. `hierarchy` thins out contact rows for
first guesses, `contact_edge` releases rows in pairs at the edge of contact.
"""
