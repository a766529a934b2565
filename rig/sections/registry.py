"""The registry of everything that a rig file can name: objects of softrig, and plug-ins of other packages.

Reading the entry points of every installed package takes some 30 ms, so a name is looked up only if softrig has no
object of that name.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Generic, TypeVar

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Loaded = TypeVar("Loaded")


class PluginError(Exception):
    """A plug-in is not installed, cannot be loaded, or is not what its entry point promises."""


class Registry(Generic[Loaded]):
    """The objects of one kind by name: those of softrig, and the entry points of the group `softrig.<kind>`."""

    def __init__(
        self, kind: str, built_in: Mapping[str, Loaded | str], check: Callable[[object], Loaded] | None = None
    ) -> None:
        """An object of softrig may be named by its place, `module:object`: it is imported when it is used.

        `check` returns what an entry point or a place names, or raises TypeError with what it should be.
        """
        self.kind, self.built_in = kind, built_in
        self._check = self.checked if check is None else check
        self._loaded: dict[str, Loaded] = {}

    def checked(self, found: object) -> Loaded:
        """The object of an entry point; raises TypeError with what it should be."""
        raise NotImplementedError

    def __getitem__(self, name: str) -> Loaded:
        """An object by name or place; imports a plug-in.

        Raises:
            PluginError: there is none or more than one of that name, it cannot be imported, or is no plug-in.
        """
        found = self.built_in.get(name, name if ":" in name else None)
        if found is not None and not isinstance(found, str):
            return found
        if name not in self._loaded:
            self._loaded[name] = self._imported(name, found)
        return self._loaded[name]

    def _imported(self, name: str, place: str | None) -> Loaded:
        entries = [entry for entry in self._entries() if entry.name == name] if place is None else []
        if place is None and len(entries) != 1:
            several = ", ".join(map(_package_of, entries))
            why = f"is installed by {several}" if several else f"is none of {', '.join(self)}"
            raise PluginError(f"softrig.{self.kind}: {name} {why}")
        try:
            return self._check(entries[0].load() if place is None else pkgutil.resolve_name(place))
        except (Exception, SystemExit) as error:  # the code of another package may raise anything
            origin = place or f"plug-in {name} of {_package_of(entries[0])} ({entries[0].value})"
            raise PluginError(f"{origin}: {type(error).__name__}: {error}") from error

    def __iter__(self) -> Iterator[str]:
        """Every name, softrig's first; reads the metadata of every installed package."""
        return iter(dict.fromkeys((*self.built_in, *(entry.name for entry in self._entries()))))

    def package(self, name: str) -> str:
        """Name and version of the package of an object."""
        return (
            "softrig" if name in self.built_in else ", ".join(_package_of(e) for e in self._entries() if e.name == name)
        )

    def facts(self, found: Loaded) -> dict[str, Any]:
        """What `rig drivers` lists of an object: the fields of its `InstalledObject`."""
        return {"about": (found.__doc__ or "").strip().split("\n")[0]}

    def installed(self) -> Iterator[tuple[str, str, dict[str, Any]]]:
        """Name, package and facts of each, the `fault` of a broken one; imports every object."""
        for name in self.built_in:
            yield name, "softrig", self.facts(self[name])
        for entry in self._entries():
            facts: dict[str, Any] = {"fault": "not used: softrig has its own"}
            if entry.name not in self.built_in:
                try:
                    facts = self.facts(self[entry.name])
                except PluginError as error:
                    facts = {"fault": str(error)}
            yield entry.name, _package_of(entry), facts

    def _entries(self) -> list[EntryPoint]:
        from importlib.metadata import entry_points

        return sorted(entry_points(group=f"softrig.{self.kind}"), key=lambda entry: entry.name)


def _package_of(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "an unnamed package"
