"""The options of a run on the command line, from their declaration in `rig.experiment.options`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import Field, dataclass, field
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer

from rig.cli import completion
from rig.experiment.options import Option, RunOptions, declared


@dataclass(frozen=True)
class _Form:
    """How an option is given: type and default on the command line, the conversion of (flag, value), and for Typer."""

    type: Any
    default: Any
    convert: Callable[[str, Any], Any] = lambda flag, given: given
    typer: Mapping[str, Any] = field(default_factory=dict)


# The modules that convert are imported when a command runs: shell completion and --help do not wait for them.
def _numbers(flag: str, given: list[str] | None) -> dict[str, float]:
    from rig.cli.assignments import numbers

    return numbers(flag, given)


def _texts(flag: str, given: list[str] | None) -> dict[str, str]:
    from rig.cli.assignments import texts

    return texts(flag, given)


def _names(flag: str, given: str) -> list[str]:
    from rig.cli.assignments import names

    return names(given)


def _resolved(flag: str, given: list[Path] | None) -> list[Path]:
    from rig.cli.run_names import resolve

    return [resolve(name) for name in given or ()]


_FORMS: Mapping[str | None, _Form] = {
    "NAME=NUMBER": _Form(list[str] | None, None, _numbers),
    "NAME=VALUE": _Form(list[str] | None, None, _texts),
    "NAME,..": _Form(str, "", _names),
    "RUN": _Form(list[Path] | None, None, _resolved, {"autocompletion": completion.runs}),
    "DIR": _Form(Path, completion.DATA, typer={"file_okay": False}),
    "FILE": _Form(Path | None, None, typer={"dir_okay": False}),
}
"""Forms of values by their metavar; other options are switches, words and numbers."""


def _form(one: Field[Any]) -> _Form:
    found, default = _FORMS.get(_about(one).metavar), one.default
    if found is not None:
        return found
    if isinstance(default, bool):
        # A switch that is on by itself is given as its negation.
        return _Form(bool, False, lambda flag, given: given is not default)
    return _Form(str | None if default is None else type(default), default)


def _about(one: Field[Any]) -> Option:
    about: Option = one.metadata["option"]
    return about


def of_run(name: str, otherwise: str | None = None) -> Any:
    """An option of a run for Typer; `otherwise` says what a command uses without it."""
    one = declared()[name]
    about = _about(one)
    return typer.Option(
        about.flag,
        metavar=about.metavar,
        help=about.help,
        min=about.least,
        show_default=otherwise or about.otherwise or True,
        **_form(one).typer,
    )


def takes_run_options(*names: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Replace the parameter `options` of a command by options of a run: those of `names`, all without any."""
    chosen = {f"no_{name}" if one.default is True else name: one for name, one in declared(RunOptions, *names).items()}

    def decorated(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command, eval_str=True)
        kind = signature.parameters["options"].kind
        made = [
            inspect.Parameter(
                name, kind, default=_form(one).default, annotation=Annotated[_form(one).type, of_run(one.name)]
            )
            for name, one in chosen.items()
        ]
        parameters: list[inspect.Parameter] = []
        for name, parameter in signature.parameters.items():
            parameters += made if name == "options" else [parameter]

        @wraps(command)
        def called(**given: Any) -> None:
            values = {one.name: _form(one).convert(_about(one).flag, given.pop(name)) for name, one in chosen.items()}
            command(**given, options=RunOptions(**values))

        called.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        called.__annotations__ = {one.name: one.annotation for one in parameters}
        return called

    return decorated
