"""What can be wrong with a bag."""


class BagError(ValueError):
    """A bag cannot be read or written; the message names it and says why."""


class UnknownTypeError(BagError):
    """No definition of a message type is at hand."""
