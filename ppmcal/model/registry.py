"""Kinds by name: those of this package, and those added by other packages."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Generic, Protocol, TypeVar

from ppmcal.errors import unknown


class Named(Protocol):
    """What can be registered."""

    @property
    def name(self) -> str:
        """As in files."""


T = TypeVar("T", bound=Named)


class Registry(Generic[T]):
    """The kinds of one sort.

    Other packages add kinds through an entry-point group: each entry loads a kind. Entries are
    loaded when kinds are first needed, because their packages import this one.
    """

    def __init__(self, sort: str, group: str) -> None:
        self._sort, self._group = sort, group
        self._kinds: dict[str, T] = {}
        self._loaded = False

    def register(self, kind: T) -> T:
        """Add a kind.

        Raises:
            ValueError: its name is taken.
        """
        if kind.name in self._kinds:
            raise ValueError(f"{self._sort} '{kind.name}' is registered twice")
        self._kinds[kind.name] = kind
        return kind

    def own(self) -> dict[str, T]:
        """Return the kinds registered so far, without those of other packages."""
        return dict(self._kinds)

    def kinds(self) -> dict[str, T]:
        """Return all kinds by name, those of other packages last."""
        if not self._loaded:
            self._loaded = True
            for entry in entry_points(group=self._group):
                self.register(entry.load())
        return dict(self._kinds)

    def find(self, name: str, where: str = "") -> T:
        """Return the kind called ``name``.

        Raises:
            BadInput: unknown name; lists the valid ones and the nearest match.
        """
        kinds = self.kinds()
        if name not in kinds:
            raise unknown(self._sort, name, kinds, where)
        return kinds[name]
