"""Errors about bags."""


class BagError(ValueError):
    """A bag cannot be read or written; the message names the bag and the reason."""


class UnknownTypeError(BagError):
    """A message type has no definition, neither in the bag nor among the installed packages."""
