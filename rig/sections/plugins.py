"""Plug-ins: objects that other packages bring by entry points, and sections of the rig file whose model they bring.

Reading the entry points of every installed package takes some 30 ms, so a name is looked up only if softrig has no
object of that name.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, GetCoreSchemaHandler, ValidationError, ValidationInfo, ValidatorFunctionWrapHandler
from pydantic_core import CoreSchema, core_schema

from protocols.problems import closest
from protocols.validation import ValidationFault, faults, nested_faults

Loaded = TypeVar("Loaded")
RECORDED = "recorded"
"""Key of the validation context of a rig from an archive: a plug-in that is not installed here is no fault then."""


class PluginError(Exception):
    """A plug-in is not installed, cannot be loaded, or is not what its entry point promises."""


@dataclass(frozen=True)
class PluginGroup(Generic[Loaded]):
    """The entry points of one group. `check` returns the object, or raises TypeError with what it should be."""

    group: str
    check: Callable[[str, object], Loaded]

    def entries(self) -> tuple[EntryPoint, ...]:
        """The installed entry points; reads the metadata of every installed package."""
        return tuple(sorted(entry_points(group=self.group), key=lambda entry: entry.name))

    def load(self, name: str) -> tuple[Loaded, str]:
        """Import a plug-in; return its object and its package.

        Raises:
            PluginError: there is none or more than one of that name, it cannot be imported, or is no plug-in.
        """
        found = [entry for entry in self.entries() if entry.name == name]
        if len(found) != 1:
            several = ", ".join(map(package_of, found))
            raise PluginError(f"{self.group}: {name} is installed by {several or 'no package'}")
        entry = found[0]
        try:
            return self.check(name, entry.load()), package_of(entry)
        except (Exception, SystemExit) as error:  # the code of another package may raise anything
            raise PluginError(
                f"plug-in {name} of {package_of(entry)} ({entry.value}): {type(error).__name__}: {error}"
            ) from error


def package_of(entry: EntryPoint) -> str:
    """Name and version of the package of an entry point."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "an unnamed package"


@dataclass(frozen=True)
class PluginSections:
    """Annotation of a section, or of a union of sections, to which plug-ins add models.

    The key `tag` of the section names one. `base` is the class of every such section; `built_in` are softrig's names,
    `plugins` the names that are installed beside them, and `model` returns the model of one of these. In a rig from an
    archive a plug-in that is not installed is read by `unknown`.
    """

    tag: str
    base: type[BaseModel]
    built_in: Collection[str]
    plugins: Callable[[], Sequence[str]]
    model: Callable[[str], type[BaseModel]]
    unknown: type[BaseModel]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate by the named model; serialise every key of it."""
        as_it_is = core_schema.wrap_serializer_function_ser_schema(
            lambda value, serialise: serialise(value), schema=core_schema.any_schema()
        )
        return core_schema.with_info_wrap_validator_function(self._validated, handler(source), serialization=as_it_is)

    def _validated(self, value: Any, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
        if isinstance(value, self.base):
            return value
        name = value.get(self.tag) if isinstance(value, dict) else None
        if not isinstance(name, str) or name in self.built_in:
            return handler(value)
        installed = self.plugins()
        recorded = bool(info.context and info.context.get(RECORDED))
        model: type[BaseModel] | None = None
        if name in installed:
            try:
                model = self.model(name)
            except PluginError as error:
                if not recorded:
                    faults([ValidationFault((self.tag,), f"a plug-in that can be loaded: {error}")])
        elif not recorded:
            known = (*self.built_in, *installed)
            faults([ValidationFault((self.tag,), f"one of {', '.join(known)}", closest(name, known))])
        try:
            return (model or self.unknown).model_validate(value)
        except ValidationError as error:
            raise nested_faults(error, model or self.unknown) from None
