"""Sections of the scene file as typed, every key documented here.

The models are the schema (``contact-app schema``), and their descriptions the manual. They check
types and ranges; what needs more than one key (names, dimensions) is checked when the scene is
built.
"""
