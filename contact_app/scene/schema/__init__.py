"""Sections of the scene file as typed by the user; every key is documented here.

The models define the schema (``contact-app schema``), and their descriptions are the manual. They
check types and ranges. Checks of several keys (names, dimensions) follow when the scene is built.
"""
