"""The operators of a run and of a study that a Python program started: prompts are answered by a function."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from rig.execution.plan import NullOperator, Progress
from rig.experiment.prepare import PreparedRun
from rig.experiment.run import RunResult
from runs.records import Event, Status

Answer = Callable[[str], object]
"""Called with the message of a prompt; the run continues when it returns."""


class FunctionOperator(NullOperator):
    """Stops the run on request. Passes each prompt to `answer`, in a thread of its own: the run never waits for it."""

    def __init__(self, stop_reason: Callable[[], str | None], answer: Answer | None) -> None:
        self._stop_reason = stop_reason
        self._answer = answer
        self._shown: str | None = None
        self._answered = threading.Event()
        self._failure: str | None = None
        self.events: list[Event] = []

    def show(self, progress: Progress) -> None:
        """Start to answer a new prompt."""
        if progress.prompt is not None and progress.prompt != self._shown and self._answer is not None:
            threading.Thread(target=self._ask, args=(self._answer, progress.prompt), daemon=True).start()
        self._shown = progress.prompt

    def report(self, event: Event) -> None:
        self.events.append(event)

    def answered(self) -> bool:
        """Return whether the function has returned."""
        done = self._answered.is_set()
        if done:
            self._answered.clear()
        return done

    def stop_requested(self) -> str | None:
        """Return the reason of a stop: a signal, or an error of the function."""
        return self._stop_reason() or self._failure

    def _ask(self, answer: Answer, prompt: str) -> None:
        try:
            answer(prompt)
        except Exception as error:
            self._failure = f"the prompt was not answered: {type(error).__name__}: {error}"
        else:
            self._answered.set()


class FunctionStudyOperator:
    """Performs runs by `perform`, rests by sleeping, and passes each prompt to `answer`."""

    def __init__(self, perform: Callable[[PreparedRun], RunResult], answer: Answer | None) -> None:
        self._perform = perform
        self._answer = answer

    def run(self, prepared: PreparedRun) -> Status:
        """Perform a run; return how it ended."""
        return self._perform(prepared).outcome.status

    def rest(self, seconds: float) -> None:
        """Wait."""
        time.sleep(seconds)

    def confirm(self, prompt: str) -> None:
        """Return when the function has returned."""
        if self._answer is not None:
            self._answer(prompt)
