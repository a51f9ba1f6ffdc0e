"""A sentence about a result: its text, its level, and its topic.

Both are set once, where the sentence is written. The level decides the exit code, and code selects
by topic, never by wording.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any, Literal, TypeVar, cast

S = TypeVar("S", bound=str)
Level = Literal["note", "finding"]
NOTE: Level = "note"
"""Good to know."""
FINDING: Level = "finding"
"""Needs the user's attention: the command ends with exit code 1."""


class Note(str):
    """A sentence with its level and its topic; plain text to code that prints or writes it.

    Attributes:
        level: :data:`NOTE` or :data:`FINDING`.
        topic: what it is about; empty if no code selects by it.
    """

    __slots__ = ("level", "topic")
    level: Level
    topic: str

    def __new__(cls, text: str, level: Level = FINDING, topic: str = "") -> Note:
        """Make a sentence with a fixed level and topic."""
        self = super().__new__(cls, text)
        object.__setattr__(self, "level", level)
        object.__setattr__(self, "topic", topic)
        return self

    def __setattr__(self, name: str, value: Any) -> None:
        """Refuse a change."""
        raise AttributeError(f"a note has one {name}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to rebuild it in another process (pickle)."""
        return Note, (str(self), self.level, self.topic)


def level_of(sentence: str) -> Level:
    """Return the level of a sentence; bare text, as from other packages, is a finding."""
    return cast("Level", getattr(sentence, "level", FINDING))


def topic_of(sentence: str) -> str:
    """Return the topic of a sentence, empty if it has none."""
    return str(getattr(sentence, "topic", ""))


def about(sentences: Iterable[S], topics: Collection[str]) -> list[S]:
    """Return the sentences on any of the topics."""
    return [s for s in sentences if topic_of(s) in topics]


def of_column(source: str, column: str) -> str:
    """Return the topic of notes on one column of a file; their text begins with it."""
    return f"{source}: column {column}"


def has_findings(sentences: Iterable[str]) -> bool:
    """Whether a command with these sentences ends with exit code 1: decided only here."""
    return any(level_of(s) == FINDING for s in sentences)
