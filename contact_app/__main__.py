"""``python -m contact_app`` is ``contact-app``."""

from contact_app.cli import main

main()
