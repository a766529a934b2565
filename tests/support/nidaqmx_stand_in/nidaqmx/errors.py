"""Errors of NI-DAQmx."""


class Error(Exception):
    """Base of all."""


class DaqError(Error):
    """An error of the driver."""

    def __init__(self, message: str, error_code: int, task_name: str = "") -> None:
        super().__init__(message)
        self.error_code = error_code
