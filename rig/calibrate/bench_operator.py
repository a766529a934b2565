"""What calibration needs from the operator at the bench."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Protocol


class Keys(Protocol):
    """The characters that the operator types."""

    @property
    def ended(self) -> bool:
        """True once the input has ended."""

    def pressed(self) -> str:
        """Return the characters since the last call, without waiting."""


class BenchOperator(Protocol):
    """The operator: reads instructions, types, acts and stops."""

    def tell(self, line: str) -> None:
        """Show an instruction or the progress."""

    def confirm(self) -> bool:
        """Ask whether pressures may rise."""

    def wait(self, instruction: str) -> None:
        """Show an instruction; return when the operator has followed it."""

    def keys(self) -> AbstractContextManager[Keys]:
        """Read single keys while entered."""
