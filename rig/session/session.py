"""Runs from Python, with the defaults, checks, watchdog and interlocks of the command line."""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from functools import partial
from pathlib import Path

from protocols import Problem, Protocol, arguments
from protocols.problems import bad_input, raise_all
from rig.config.loader import RigChoice, chosen_rig, load
from rig.config.schema import RigConfig
from rig.execution.plan import RunPlan
from rig.execution.stop_signals import StopSignals
from rig.experiment import report_process
from rig.experiment import run as experiment
from rig.experiment.run import RunRequest, RunResult
from rig.experiment.simulate import simulate
from rig.realtime.control_socket import socket_of
from rig.session.operators import Answer, FunctionOperator, FunctionStudyOperator
from rig.study import execution
from rig.study.study import load as load_study
from rig.study.study import recovered
from runs.records import Status
from runs.run import Run, paths_of
from runs.run_names import DATA


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

    def check(self, protocol: Protocol | Path | str, *, settings: Mapping[str, float] | None = None) -> RunPlan:
        """Check a protocol as `rig check` does; return its plan, which has the set-points over time.

        Metadata that the rig file requires are checked by `run`, which is given them.

        Raises:
            BadInputError: everything that is wrong with protocol and rig.
        """
        return experiment.plan(experiment.request(_named(protocol), self._choice, settings=settings))

    def run(
        self,
        protocol: Protocol | Path | str,
        *,
        settings: Mapping[str, float] | None = None,
        fast: bool = False,
        seed: int = 0,
        out: Path | str = DATA,
        model: str | None = None,
        parameters: Path | str | None = None,
        operator: str = "",
        note: str = "",
        meta: Mapping[str, str | float] | None = None,
        yes: bool = False,
        report: bool = True,
        adapt: bool | Sequence[str] = False,
        controller: str | None = None,
        learn_from: Sequence[Run | Path | str] = (),
        answer: Answer | None = None,
    ) -> Run:
        """Run a protocol as `rig run` does; return its archive.

        The protocol is a name, a file, or one that is loaded, as by `protocols.from_steps`. The options are those of
        the command. A rig with real valves needs `yes=True`, which arms it without a question. `adapt` is True, or the
        names of the parameters to estimate online. `answer` is called with the message of each prompt in real time; the
        run continues when it returns.

        Raises:
            BadInputError: everything that is wrong with protocol, rig and options.
            RunInterruptedError, RunEndedError: the run did not finish; the error has its archive.
            CardError, CameraError, StartError, JournalError: the run did not start.
        """
        self._require_entered()
        _check_options(answer, fast=fast, yes=yes, report=report)
        request = experiment.request(
            _named(protocol),
            self._choice,
            settings=settings,
            adapt=None if adapt is False else () if adapt is True else arguments.names("--free", adapt),
            folder=arguments.folder("--out", out),
            fast=fast,
            seed=seed,
            variant=model,
            parameters=_parameters_file(parameters),
            operator=operator,
            notes=note,
            metadata={} if meta is None else meta,
            controller=controller,
            learn_from=paths_of(learn_from),
            report=report,
        )
        plan = experiment.plan(request)
        _check_arming(request, plan, yes, answer)
        return _archive(_run(request, plan, answer))

    def simulate(
        self,
        protocol: Protocol | Path | str,
        *,
        settings: Mapping[str, float] | None = None,
        out: Path | str = DATA,
        model: str | None = None,
        parameters: Path | str | None = None,
    ) -> Run:
        """Run the model alone as `rig simulate` does; return its archive.

        Raises:
            BadInputError: everything that is wrong with protocol, rig and options.
        """
        request = experiment.request(
            _named(protocol),
            self._choice,
            settings=settings,
            folder=arguments.folder("--out", out),
            variant=model,
            parameters=_parameters_file(parameters),
        )
        return Run(simulate(request, experiment.plan(request)))

    def study(
        self,
        plan: Path | str,
        *,
        fast: bool = False,
        out: Path | str = DATA,
        operator: str = "",
        meta: Mapping[str, str | float] | None = None,
        workers: int | None = None,
        scheduler: str | None = None,
        yes: bool = False,
        answer: Answer | None = None,
    ) -> tuple[Run, ...]:
        """Run what is missing of a study as `rig study` does; return its finished runs in their order.

        `workers` is the number of processes in virtual time, by default one per core. `yes` and `answer` are those of
        `run`; a script that studies over several processes needs `if __name__ == "__main__":`.

        Raises:
            BadInputError: everything that is wrong with plan, protocols and rig.
            OtherStudyError, StudyBusyError, StudyStoppedError: the study cannot begin, or a rule of it ended it.
            KeyboardInterrupt: Ctrl-C; repeat the call to go on.
        """
        self._require_entered()
        _check_options(answer, fast=fast, yes=yes)
        if workers is not None:
            raise_all(arguments.whole_number_problems("workers", workers, 1))
        if scheduler is not None:
            raise_all(arguments.text_problems({"--scheduler": scheduler}))
        folder, file = arguments.folder("--out", out), arguments.path("PLAN", plan)
        study = load_study(file, self._choice, folder=folder, fast=fast, operator=operator, metadata=meta)
        for run in study.runs:
            _check_arming(*study.request(run), yes, answer)
        if not fast and study.plan.block_prompt and answer is None:
            expected = "a function for the prompts before the blocks, such as answer=input"
            raise bad_input("answer", "None", expected)
        with execution.locked(study) as scratch:
            for sentence in recovered(study.folder):
                warnings.warn(sentence, stacklevel=2)
            try:
                if fast:
                    execution.run_virtual(study, scratch, workers, scheduler)
                else:
                    execution.run_real(study, FunctionStudyOperator(partial(_run, answer=answer), answer))
            finally:
                results = execution.write_results(study)
        return () if results is None else tuple(Run(folder / entry.file) for entry in results.runs.values())

    def _require_entered(self) -> None:
        if not self._entered:
            raise bad_input("rig.open", "", "open it first: `with rig.open(..) as bench:`")


def _named(protocol: Protocol | Path | str) -> Protocol | str:
    return protocol if isinstance(protocol, Protocol) else str(protocol)


def _check_options(answer: object, **flags: bool) -> None:
    problems = arguments.flag_problems(flags)
    if answer is not None and not callable(answer):
        problems.append(Problem("answer", 0, 0, "", arguments.shown(answer), "a function, such as answer=input"))
    raise_all(problems)


def _parameters_file(parameters: Path | str | None) -> Path | None:
    return None if parameters is None else arguments.path("--parameters", parameters)


def _check_arming(request: RunRequest, plan: RunPlan, yes: bool, answer: Answer | None) -> None:
    problems = []
    if request.config.has_real_valves and not yes:
        expected = f"yes=True: rig {request.config.name} has real valves, and this arms them without a question"
        problems.append(Problem("yes", 0, 0, "", "False", expected))
    if not request.fast and plan.trajectory.prompts and answer is None:
        expected = f"a function for the {len(plan.trajectory.prompts)} prompts of the protocol, such as answer=input"
        problems.append(Problem("answer", 0, 0, "", "None", expected))
    raise_all(problems)


def _run(request: RunRequest, plan: RunPlan, answer: Answer | None) -> RunResult:
    """Run a plan. Signals reach only the main thread of Python; a run in another thread leaves them alone."""
    in_main_thread = threading.current_thread() is threading.main_thread()
    with ExitStack() as stack:
        begin_report = stack.enter_context(report_process.prepared(request.fast and request.report))
        stopping: AbstractContextManager[StopSignals | None] = (
            StopSignals(restore=True) if in_main_thread else nullcontext()
        )
        signals = stack.enter_context(stopping)
        operator = FunctionOperator(lambda: signals.reason if signals else None, answer)
        return experiment.run(request, plan, operator, begin_report)


def _archive(result: RunResult) -> Run:
    if result.outcome.status is Status.INTERRUPTED:
        raise RunInterruptedError(result)
    if result.outcome.status is not Status.FINISHED or result.archive is None:
        raise RunEndedError(result)
    for warning in filter(None, (result.outcome.message, *result.warnings)):
        warnings.warn(warning, stacklevel=3)
    return Run(result.archive)
