"""Registries of softrig's objects, to which other packages add by entry points, and sections of the rig file from them.

Reading the entry points of every installed package takes some 30 ms, so a name is looked up only if softrig has no
object of that name.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Annotated, Any, Generic, TypeVar

from pydantic import (
    BaseModel,
    Field,
    GetCoreSchemaHandler,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
)
from pydantic_core import CoreSchema, core_schema

from protocols.problems import closest
from protocols.validation import ValidationFault, faults, nested_faults

Loaded = TypeVar("Loaded")
RECORDED = "recorded"
"""Key of the validation context of a rig from an archive: a plug-in that is not installed here is no fault then."""


class PluginError(Exception):
    """A plug-in is not installed, cannot be loaded, or is not what its entry point promises."""


class Registry(Generic[Loaded]):
    """The objects of one kind: those of softrig, and the entry points of a group."""

    def __init__(self, group: str, built_in: Mapping[str, Loaded], check: Callable[[object], Loaded]) -> None:
        """`check` returns the object of an entry point, or raises TypeError with what it should be."""
        self.built_in = built_in
        self._group, self._check = group, check
        self._loaded: dict[str, Loaded] = {}

    def __getitem__(self, name: str) -> Loaded:
        """An object by name; imports a plug-in.

        Raises:
            PluginError: there is none or more than one of that name, it cannot be imported, or is no plug-in.
        """
        if name in self.built_in:
            return self.built_in[name]
        if name not in self._loaded:
            found = [entry for entry in self._entries() if entry.name == name]
            if len(found) != 1:
                several = ", ".join(map(_package_of, found))
                raise PluginError(f"{self._group}: {name} is installed by {several or 'no package'}")
            try:
                self._loaded[name] = self._check(found[0].load())
            except (Exception, SystemExit) as error:  # the code of another package may raise anything
                origin = f"plug-in {name} of {_package_of(found[0])} ({found[0].value})"
                raise PluginError(f"{origin}: {type(error).__name__}: {error}") from error
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        """Every name, softrig's first; reads the metadata of every installed package."""
        return iter(dict.fromkeys((*self.built_in, *(entry.name for entry in self._entries()))))

    def package(self, name: str) -> str:
        """Name and version of the package of an object."""
        return (
            "softrig" if name in self.built_in else ", ".join(_package_of(e) for e in self._entries() if e.name == name)
        )

    def installed(self) -> Iterator[tuple[str, str, Loaded | None, str]]:
        """Name, package, object and fault of each, None with the fault where it is broken; imports every plug-in."""
        yield from ((name, "softrig", found, "") for name, found in self.built_in.items())
        for entry in self._entries():
            found: Loaded | None = None
            fault = "not used: softrig has its own"
            if entry.name not in self.built_in:
                try:
                    found, fault = self[entry.name], ""
                except PluginError as error:
                    fault = str(error)
            yield entry.name, _package_of(entry), found, fault

    def _entries(self) -> list[EntryPoint]:
        return sorted(entry_points(group=self._group), key=lambda entry: entry.name)


def _package_of(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "an unnamed package"


@dataclass(frozen=True)
class PluginSections(Generic[Loaded]):
    """Annotation of a section, or of a union of sections, to which plug-ins add models.

    The key `tag` of the section names an object of the `registry`, whose section has the model that `model` returns.
    `base` is the class of every such section. In a rig from an archive a plug-in that is not installed is read by
    `unknown`.
    """

    registry: Registry[Loaded]
    tag: str
    base: type[BaseModel]
    model: Callable[[Loaded], type[BaseModel]]
    unknown: type[BaseModel]

    @property
    def section(self) -> Any:
        """The type of the section in the rig file."""
        models = tuple(dict.fromkeys(self.model(found) for found in self.registry.built_in.values()))
        own: Any = functools.reduce(operator.or_, models)
        return Annotated[Annotated[own, Field(discriminator=self.tag)] if len(models) > 1 else own, self]

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
        if not isinstance(name, str) or name in self.registry.built_in:
            return handler(value)
        known, model = tuple(self.registry), self.unknown
        recorded = bool(info.context and info.context.get(RECORDED))
        if name in known:
            try:
                model = self.model(self.registry[name])
            except PluginError as error:
                if not recorded:
                    faults([ValidationFault((self.tag,), f"a plug-in that can be loaded: {error}")])
        elif not recorded:
            faults([ValidationFault((self.tag,), f"one of {', '.join(known)}", closest(name, known))])
        try:
            return model.model_validate(value)
        except ValidationError as error:
            raise nested_faults(error, model) from None
