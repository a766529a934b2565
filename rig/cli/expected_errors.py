"""Expected errors: which they are, and the message and exit status with which a command ends."""

from __future__ import annotations

import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import typer

from rig.cli.commands import HelpGroup
from rig.cli.exit_status import BAD_INPUT, FAULT, INTERRUPTED


class PlainErrors(HelpGroup):
    """Command group that prints expected errors as one message with an exit status, without a traceback."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Complete the line of a shell, which prints before the options are read, or run a command."""
        try:
            with _errors_as_messages():
                return super().main(*args, **kwargs)
        except typer.Exit as exit_:
            sys.exit(exit_.exit_code)

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        """Read the options before the command; `--help` and `--version` print here."""
        with _errors_as_messages():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: Any) -> Any:
        with _errors_as_messages():
            return super().invoke(ctx)


@contextmanager
def _errors_as_messages() -> Iterator[None]:
    try:
        yield
    except (typer.Exit, typer.Abort):
        raise
    except typer.BadParameter as error:
        error.message = _with_value(error)
        raise
    except KeyboardInterrupt:
        fail("interrupted", INTERRUPTED)
    except Exception as error:
        status = _status(error)
        # The reader of the output has left (`rig runs | head -1`); click ends the command without a message.
        if status is None or (isinstance(error, BrokenPipeError) and _reader_is_gone()):
            raise
        fail(_message(error), status)


def _reader_is_gone() -> bool:
    """Return whether standard output or standard error is a pipe without a reader; other pipes may be broken, too."""
    streams = select.poll()
    for fd in (1, 2):
        streams.register(fd, 0)
    return any(event & select.POLLERR for _, event in streams.poll(0))


EXPECTED_ERRORS = {
    "protocols.problems.BadInputError": BAD_INPUT,
    "runs.overwriting.WouldOverwriteError": BAD_INPUT,
    "runs.archive.digest.ArchiveError": BAD_INPUT,
    "runs.archive.digest.DamagedArchiveError": FAULT,
    "runs.annotations.AnnotationError": BAD_INPUT,
    "runs.arguments.ArgumentError": BAD_INPUT,
    "runs.export.exporters.ExportError": BAD_INPUT,
    "runs.export.exporters.ExportWriteError": FAULT,
    "calibration.camera.CalibrationError": BAD_INPUT,
    "calibration.dlt.DLTError": BAD_INPUT,
    "calibration.views.ViewsError": BAD_INPUT,
    "calibration.identify.errors.NoDataError": BAD_INPUT,
    "calibration.identify.unknowns.parameters.UnknownParameter": BAD_INPUT,
    "model.errors.SeveralSegments": BAD_INPUT,
    "model.paper.identification.TooFewLoadsError": BAD_INPUT,
    "calibration.identify.recursive_estimator.NotEstimableError": BAD_INPUT,
    "calibration.parallel_map.NoClusterError": FAULT,
    "calibration.parallel_map.WorkerDiedError": FAULT,
    "rig.calibrate.bench_driver.TrippedError": FAULT,
    "rig.sections.registry.PluginError": BAD_INPUT,
    "rig.study.execution.StudyStoppedError": FAULT,
    "rig.study.study.OtherStudyError": BAD_INPUT,
    "rig.execution.plan.StoppedError": INTERRUPTED,
    "rig.execution.plan.StartError": FAULT,
    "rig.hardware.driver_calls.TipSourceError": FAULT,
    "rig.hardware.cards.base.CardError": FAULT,
    "runs.journal.append_only_file.JournalError": FAULT,
    "builtins.MemoryError": FAULT,
    "builtins.OSError": FAULT,
}
"""Exit status by class. Names, because an import here costs time and fails where memory is short."""


_EXPECTED = {
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "greater_than_equal": "at least {ge:g}",
    "less_than_equal": "at most {le:g}",
}
"""What is expected of the value of an option, by the kind of pydantic's error."""


def _with_value(error: typer.BadParameter) -> str:
    """Return the message about an invalid value; a number is checked by pydantic, whose message leaves it out."""
    cause = error.__cause__
    if cause is None or not hasattr(cause, "errors"):
        return error.message
    (first, *_) = cause.errors()
    if first["type"] not in _EXPECTED:
        return error.message.removeprefix("Value error, ")
    return f"found {first['input']}, expected {_EXPECTED[first['type']].format(**first.get('ctx', {}))}"


def _message(error: Exception) -> str:
    """Return the message of an error; of an OSError without its number."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if isinstance(error.filename, str) else error.strerror
    if extra := _extra_of(error):
        return f"this command needs more of softrig: pip install 'softrig[{extra}]'"
    if isinstance(error, MemoryError) or _is_unloadable(error):
        return f"not enough memory: {error}" if str(error) else "not enough memory"
    return str(error)


def is_expected(error: Exception) -> bool:
    """Return whether an error ends a command with a message."""
    return isinstance(error, typer.Exit | typer.Abort) or _status(error) is not None


def _status(error: Exception) -> int | None:
    """Return the exit status of an expected error; None for an unexpected one."""
    if _is_unloadable(error) or _extra_of(error):
        return FAULT
    names = (f"{kind.__module__}.{kind.__qualname__}" for kind in type(error).__mro__)
    return next((EXPECTED_ERRORS[name] for name in names if name in EXPECTED_ERRORS), None)


EXTRAS = (
    dict.fromkeys(("cv2", "daqp", "numba", "piqp", "scipy"), "rig")
    | {"rocrate": "publish"}
    | dict.fromkeys(("nicegui", "fastapi", "starlette", "uvicorn"), "live")
)
"""Extra of the package that brings a library; nicegui brings the servers."""


def _extra_of(error: Exception) -> str:
    """Return the extra that a light installation lacks; empty if the error has another reason."""
    return EXTRAS.get((error.name or "").partition(".")[0], "") if isinstance(error, ModuleNotFoundError) else ""


def _is_unloadable(error: Exception) -> bool:
    """Return whether a library could not be loaded for lack of memory."""
    words = ("failed to map segment", "cannot allocate memory")
    return isinstance(error, ImportError) and any(word in str(error).lower() for word in words)


def fail(message: str, status: int) -> NoReturn:
    """Print a message as an error and end the command."""
    typer.echo(message, err=True)
    raise typer.Exit(status)
