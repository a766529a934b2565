"""Errors of an identification."""


class NoDataError(ValueError):
    """The runs do not contain the data that the identification needs."""
