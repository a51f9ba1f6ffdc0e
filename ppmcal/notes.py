"""A sentence about a result: its text, whether it needs a look, and what it is about.

Whoever makes a sentence says this once. The level gives the exit code, and code asks for topics,
never for words.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any, Literal, TypeVar, cast

S = TypeVar("S", bound=str)
Level = Literal["note", "finding"]
NOTE: Level = "note"
"""Good to know."""
FINDING: Level = "finding"
"""The user must look at it: the command leaves with exit code 1."""


class Note(str):
    """A sentence with its level and its topic; text to whoever prints or writes it.

    Attributes:
        level: :data:`NOTE` or :data:`FINDING`.
        topic: what it is about, empty where no code asks.
    """

    __slots__ = ("level", "topic")
    level: Level
    topic: str

    def __new__(cls, text: str, level: Level = FINDING, topic: str = "") -> Note:
        """Make a sentence; its level and topic stay as they are."""
        self = super().__new__(cls, text)
        object.__setattr__(self, "level", level)
        object.__setattr__(self, "topic", topic)
        return self

    def __setattr__(self, name: str, value: Any) -> None:
        """Refuse a change."""
        raise AttributeError(f"a note has one {name}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how another process makes it."""
        return Note, (str(self), self.level, self.topic)


def level_of(sentence: str) -> Level:
    """Return the level of a sentence; a bare text, as other packages give, is a finding."""
    return cast("Level", getattr(sentence, "level", FINDING))


def topic_of(sentence: str) -> str:
    """Return what a sentence is about, empty where it does not say."""
    return str(getattr(sentence, "topic", ""))


def about(sentences: Iterable[S], topics: Collection[str]) -> list[S]:
    """Return the sentences on any of some topics."""
    return [s for s in sentences if topic_of(s) in topics]


def of_column(source: str, column: str) -> str:
    """Return the topic of what is said of one column of a file; the sentence begins with it."""
    return f"{source}: column {column}"


def has_findings(sentences: Iterable[str]) -> bool:
    """Whether a command that says this leaves with exit code 1: the one place that decides it."""
    return any(level_of(s) == FINDING for s in sentences)
