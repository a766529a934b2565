"""Runs from Python, with the defaults, checks, watchdog and interlocks of the command line."""

from __future__ import annotations

import inspect
import os
import threading
import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass
from functools import partial, wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

from protocols import Problem, Protocol, arguments
from protocols.problems import bad_input, raise_all
from rig.config.loader import RigChoice, chosen_rig, load
from rig.config.schema import RigConfig
from rig.execution.plan import RunPlan
from rig.execution.stop_signals import StopSignals
from rig.experiment import report_process
from rig.experiment import run as experiment
from rig.experiment.options import RunOptions
from rig.experiment.prepare import PreparedRun, prepare
from rig.experiment.run import RunResult
from rig.experiment.simulate import simulate
from rig.realtime.control_socket import socket_of
from rig.session.operators import Answer, FunctionOperator, FunctionStudyOperator
from rig.study import execution
from rig.study.study import load as load_study
from rig.study.study import recovered
from runs.records import Status
from runs.run import Run


class RunEndedError(Exception):
    """A fault or a limit ended a run. The valves are safe; `result` has the files of the run."""

    def __init__(self, result: RunResult) -> None:
        self.result = result
        super().__init__(_ending(result))


class RunInterruptedError(KeyboardInterrupt):
    """Ctrl-C, SIGTERM or SIGHUP ended a run. The valves are safe; `result` has the files of the run.

    `except Exception` does not catch it: a loop over runs ends.
    """

    def __init__(self, result: RunResult) -> None:
        self.result = result
        super().__init__(_ending(result))


def _ending(result: RunResult) -> str:
    outcome = result.outcome
    return "; ".join((f"{outcome.status}: {outcome.message}", f"archive: {result.archive}", *result.warnings))


@dataclass(frozen=True, kw_only=True)
class SessionOptions(RunOptions):
    """The options of a run, and what answers its prompts."""

    answer: Answer | None = None


@dataclass(frozen=True, kw_only=True)
class StudyOptions(SessionOptions):
    """The options of the runs of a study, and where they take place in virtual time: `rig study --scheduler`.

    `workers` is the number of processes, by default one per core.
    """

    workers: int | None = None
    scheduler: str | None = None


ByName = ParamSpec("ByName")
Chosen = TypeVar("Chosen", bound=RunOptions)
Asked = TypeVar("Asked")
Result = TypeVar("Result")


def _by_name(
    made: Callable[ByName, Chosen], *names: str
) -> Callable[[Callable[[Session, Asked, Chosen], Result]], Callable[Concatenate[Session, Asked, ByName], Result]]:
    """Let a method take, in place of its last parameter, the options of that class by name: `names`, or all."""

    def decorated(method: Callable[[Session, Asked, Chosen], Result]) -> Any:
        session, asked, _ = inspect.signature(method).parameters.values()
        options, defaults = inspect.signature(made).parameters, made()  # type: ignore[call-arg]
        taken = [options[name].replace(default=getattr(defaults, name)) for name in names or options]
        signature = inspect.Signature([session, asked, *taken])

        @wraps(method)
        def called(*args: Any, **given: Any) -> Result:
            bound = signature.bind(*args, **given).arguments
            return method(bound.pop(session.name), bound.pop(asked.name), made(**bound))  # type: ignore[call-arg]

        called.__signature__ = signature  # type: ignore[attr-defined]
        return called

    return decorated


class Session:
    """A rig from which runs are started, between `with` and its end. `rig.open` returns it.

    Runs are strictly one after the other. Each run reads the rig file again, as a command does.
    """

    def __init__(self, rig: str | None = None) -> None:
        self._choice: RigChoice = chosen_rig(rig)
        self.config: RigConfig = load(self._choice.name)
        self._entered = False

    def __enter__(self) -> Session:
        self._entered = True
        return self

    def __exit__(self, *error: object) -> None:
        self._entered = False

    @property
    def socket(self) -> Path:
        """The control socket of the runs of this process, which is there while one takes place in real time.

        Raises:
            OSError: the folder of the sockets cannot be made, or other users can enter it.
        """
        return socket_of(os.getpid())

    @_by_name(RunOptions, "settings")
    def check(self, protocol: Protocol | Path | str, options: RunOptions) -> RunPlan:
        """Check a protocol as `rig check` does; return its plan, which has the set-points over time.

        The option `settings` sets the protocol's parameters. Metadata that the rig file requires are checked by `run`,
        which is given them.

        Raises:
            BadInputError: everything that is wrong with protocol and rig.
        """
        return prepare(protocol, self._choice, options, runs=False).plan

    @_by_name(SessionOptions)
    def run(self, protocol: Protocol | Path | str, options: SessionOptions) -> Run:
        """Run a protocol as `rig run` does; return its archive.

        The protocol is a name, a file, or one that is loaded, as by `protocols.from_steps`. The options are those of
        the command, each by its name. A rig with real valves needs `yes=True`, which arms it without a question.
        `answer` is called with the message of each prompt in real time; the run continues when it returns.

        Raises:
            BadInputError: everything that is wrong with protocol, rig and options.
            RunInterruptedError, RunEndedError: the run did not finish; the error has its archive.
            CardError, CameraError, StartError, JournalError: the run did not start.
        """
        self._require_entered()
        _check_answer(options.answer)
        prepared = prepare(protocol, self._choice, options)
        _check_arming(prepared, options)
        return _archive(_run(prepared, options.answer))

    @_by_name(RunOptions, "settings", "out", "model", "parameters")
    def simulate(self, protocol: Protocol | Path | str, options: RunOptions) -> Run:
        """Run the model alone as `rig simulate` does; return its archive.

        The options are `settings`, `out`, `model` and `parameters`.

        Raises:
            BadInputError: everything that is wrong with protocol, rig and options.
        """
        return Run(simulate(prepare(protocol, self._choice, options, runs=False)))

    @_by_name(StudyOptions, "fast", "out", "operator", "meta", "yes", "answer", "workers", "scheduler")
    def study(self, plan: Path | str, options: StudyOptions) -> tuple[Run, ...]:
        """Run what is missing of a study as `rig study` does; return its finished runs in their order.

        The options are `fast`, `out`, `operator`, `meta`, `yes` and `answer`, as of `run`, and `workers` and
        `scheduler`. A script that studies over several processes needs `if __name__ == "__main__":`.

        Raises:
            BadInputError: everything that is wrong with plan, protocols and rig.
            OtherStudyError, StudyBusyError, StudyStoppedError: the study cannot begin, or a rule of it ended it.
            KeyboardInterrupt: Ctrl-C; repeat the call to go on.
        """
        self._require_entered()
        answer, fast = options.answer, options.fast
        _check_answer(answer)
        if options.workers is not None:
            raise_all(arguments.whole_number_problems("workers", options.workers, 1))
        if options.scheduler is not None:
            raise_all(arguments.text_problems({"--scheduler": options.scheduler}))
        study = load_study(arguments.path("PLAN", plan), self._choice, options)
        for run in study.runs:
            _check_arming(study.run(run), options)
        if not fast and study.plan.block_prompt and answer is None:
            expected = "a function for the prompts before the blocks, such as answer=input"
            raise bad_input("answer", "None", expected)
        with execution.locked(study) as scratch:
            for sentence in recovered(study.folder):
                warnings.warn(sentence, stacklevel=2)
            try:
                if fast:
                    execution.run_virtual(study, scratch, options.workers, options.scheduler)
                else:
                    execution.run_real(study, FunctionStudyOperator(partial(_run, answer=answer), answer))
            finally:
                results = execution.write_results(study)
        return () if results is None else tuple(Run(study.folder / entry.file) for entry in results.runs.values())

    def _require_entered(self) -> None:
        if not self._entered:
            raise bad_input("rig.open", "", "open it first: `with rig.open(..) as bench:`")


def _check_answer(answer: object) -> None:
    if answer is not None and not callable(answer):
        raise bad_input("answer", arguments.shown(answer), "a function, such as answer=input")


def _check_arming(prepared: PreparedRun, options: SessionOptions) -> None:
    problems, prompts = [], prepared.plan.trajectory.prompts
    if prepared.config.has_real_valves and not options.yes:
        expected = f"yes=True: rig {prepared.config.name} has real valves, and this arms them without a question"
        problems.append(Problem("yes", 0, 0, "", "False", expected))
    if not options.fast and prompts and options.answer is None:
        expected = f"a function for the {len(prompts)} prompts of the protocol, such as answer=input"
        problems.append(Problem("answer", 0, 0, "", "None", expected))
    raise_all(problems)


def _run(prepared: PreparedRun, answer: Answer | None) -> RunResult:
    """Run. Signals reach only the main thread of Python; a run in another thread leaves them alone."""
    in_main_thread = threading.current_thread() is threading.main_thread()
    with ExitStack() as stack:
        begin_report = stack.enter_context(report_process.prepared(prepared.options.fast and prepared.options.report))
        stopping: AbstractContextManager[StopSignals | None] = (
            StopSignals(restore=True) if in_main_thread else nullcontext()
        )
        signals = stack.enter_context(stopping)
        operator = FunctionOperator(lambda: signals.reason if signals else None, answer)
        return experiment.run(prepared, operator, begin_report)


def _archive(result: RunResult) -> Run:
    if result.outcome.status is Status.INTERRUPTED:
        raise RunInterruptedError(result)
    if result.outcome.status is not Status.FINISHED or result.archive is None:
        raise RunEndedError(result)
    for warning in filter(None, (result.outcome.message, *result.warnings)):
        warnings.warn(warning, stacklevel=3)
    return Run(result.archive)
