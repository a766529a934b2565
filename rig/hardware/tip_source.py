"""What cameras and trackers have in common: the error that ends a run because the tip is no longer measured."""


class TipSourceError(Exception):
    """A camera or tracker could not be opened or has failed; the message contains the remedy."""
