"""Data-acquisition cards: the protocol they obey, Comedi, and the mock."""
