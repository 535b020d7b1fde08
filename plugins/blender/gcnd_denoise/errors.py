"""What the add-on tells its user when something cannot be done."""

from __future__ import annotations

__all__ = ["Failure", "Stopped"]


class Failure(Exception):
    """Reports something the user can put right.

    Args:
        message: What is wrong.
        hint: What to do about it, or None.
    """

    def __init__(self, message: str, hint: str | None = None) -> None:
        super().__init__(message)
        self.hint = hint

    def text(self) -> str:
        """Returns message and hint as Blender shows them."""
        return f"{self}\nHint: {self.hint}" if self.hint else str(self)


class Stopped(Exception):
    """Reports that the user stopped the run; nothing was changed."""
