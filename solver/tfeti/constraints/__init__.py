"""The rows of B: gluing, held nodes and contact, and products with them on all ranks.

`conditions` are what holds at nodes, `merge` makes one row of those that say the same, `rows`
writes B, `cross_points` glues nodes of many subdomains, `exchange` lets the copies of a node meet
at the rank that owns it, `matrix` is B itself. `hierarchy` has levels of contact rows for first
guesses, `contact_edge` releases rows in pairs at the edge of contact.
"""
