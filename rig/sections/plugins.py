"""Sections of the rig file whose models are registered: those of softrig and those of plug-ins."""

from __future__ import annotations

import functools
import operator
import sys
from collections.abc import Callable
from dataclasses import dataclass
from inspect import isabstract
from typing import Annotated, Any, Generic, TypeVar, cast, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
)
from pydantic_core import CoreSchema, core_schema

from protocols.problems import closest
from protocols.validation import ValidationFault, faults, nested_faults
from rig.sections.registry import Loaded, PluginError, Registry

Model = TypeVar("Model", bound=BaseModel)
_ANY_KEY = ConfigDict(extra="ignore")
RECORDED = "recorded"
"""Key of the validation context of a rig from an archive: a plug-in that is not installed here is no fault then."""


class SectionRegistry(Registry[type[Model]]):
    """Sections of the rig file by the value of their key `tag`; each is a subclass of `base`."""

    def __init__(self, kind: str, tag: str, base: type[BaseModel], *built_in: type[Model]) -> None:
        super().__init__(kind, {get_args(one.model_fields[tag].annotation)[0]: one for one in built_in})
        self.tag, self.base = tag, base

    def checked(self, found: object) -> type[Model]:
        if not (isinstance(found, type) and issubclass(found, self.base)):
            raise TypeError(f"not a subclass of {self.base.__module__}.{self.base.__name__}")
        if isabstract(found):
            raise TypeError(f"it lacks {', '.join(sorted(found.__abstractmethods__))}")
        return cast("type[Model]", found)

    def facts(self, found: type[Model]) -> dict[str, Any]:
        """What it is, and the keys that it has beside those of every such section."""
        return {**super().facts(found), "keys": own_keys(found, self.base)}

    def section(self) -> Any:
        """The type of the section in the rig file: the model that `tag` names."""
        return PluginSections(self, self.tag, self.base, lambda model: model, uninstalled(self.base, self.tag)).section


def own_keys(section: type[BaseModel], base: type[BaseModel]) -> tuple[str, ...]:
    """The keys of a section that its base has not."""
    return tuple(key for key in section.model_fields if key not in base.model_fields)


def uninstalled(base: type[BaseModel], tag: str, **members: object) -> Any:
    """A section from an archive whose plug-in is not installed here: it can be read, and what is abstract raises.

    `members` are further attributes of the class.
    """

    def missing(section: BaseModel, *_: object) -> Any:
        raise PluginError(f"{getattr(section, tag)} is not installed: this rig can be read, not used")

    name = f"Uninstalled{base.__name__}"
    abstract = {
        member: property(missing) if isinstance(getattr(base, member), property) else missing
        for member in getattr(base, "__abstractmethods__", ())
    }
    about = {"__module__": base.__module__, "__qualname__": name, "__doc__": f"A {base.__name__} without its plug-in."}
    metaclass: Any = type(base)
    found = metaclass(name, (base,), {**about, "model_config": _ANY_KEY, **abstract, **members})
    # Pickle finds the class by this name.
    setattr(sys.modules[base.__module__], name, found)
    return found


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
        models = tuple(dict.fromkeys(self.model(self.registry[name]) for name in self.registry.built_in))
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
