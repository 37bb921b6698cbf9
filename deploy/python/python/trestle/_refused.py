"""Refusals."""


class Refused(ValueError):
    """An environment, or settings for it, that cannot be used; the message names the accepted values."""
