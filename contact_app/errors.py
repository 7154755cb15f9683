"""Errors that a user can correct; the text of an error is the whole message."""


class ContactError(Exception):
    """Base of the errors that are printed without a traceback: exit code 4."""


class ConfigurationError(ContactError):
    """The input is wrong: exit code 2. The text names file, line, key and the allowed values."""


class NoEquilibriumError(ContactError):
    """The scene has no equilibrium, or conditions exclude each other: exit code 3."""


class CouldNotRunError(ContactError):
    """The program could not run: exit code 4. The text names the cause and the remedy."""
