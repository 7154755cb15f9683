"""The discrete contact problem: active sets, stopping rule, certificate, checkpoint.

`active_set` is the loop over active sets on any backend (`solver.backend`), `law` and
`friction_law` say what the rows of a contact point may do, `stopping` decides when an answer is
good enough, `certificate` recomputes from an answer how far it may be off. What it asks of the
answer is a protocol, too (`sizes.MeasuredAnswer`): nothing here knows a backend. The algorithms of
the backends stand in their own rooms, and `solver.driver` chooses one.
"""
