"""Notes and tags of a run that is named by path, run id or `last`; the archive stays as it is."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from runs import annotation_file
from runs.run import Run
from runs.run_names import resolve

_WRITABLE = re.compile(r"[^\0\ud800-\udfff]*")
_TAG = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,39}")


class AnnotationError(ValueError):
    """A text that is no note, or a word that is no tag or no tag of the run."""


def add_note(run: Path | str, text: str) -> Path:
    """Add a note to a run; return the file of its annotations.

    Raises:
        AnnotationError: the note is empty or no text.
        ArchiveError: there is no such run, or its annotations cannot be read or written.
    """
    if not (isinstance(text, str) and text.strip() and _WRITABLE.fullmatch(text)):
        raise AnnotationError(f"note {text!r}: expected a note, which is not empty and has no NUL or lone surrogate")
    archive = _archive(run)
    annotation_file.append(archive, "note", text.strip())
    return annotation_file.path_of(archive)


def add_tags(run: Path | str, tags: Iterable[str]) -> Path:
    """Add the tags that a run does not have yet; return the file of its annotations.

    Raises:
        AnnotationError: a tag is not one word; none is added.
        ArchiveError: there is no such run, or its annotations cannot be read or written.
    """
    wanted = _words(tags)
    archive = _archive(run)
    present = annotation_file.read(archive).tags
    for tag in wanted:
        if tag not in present:
            annotation_file.append(archive, "tag", tag)
    return annotation_file.path_of(archive)


def remove_tags(run: Path | str, tags: Iterable[str]) -> Path:
    """Remove tags of a run; return the file of its annotations.

    Raises:
        AnnotationError: a tag is not one of the run; none is removed.
        ArchiveError: there is no such run, or its annotations cannot be read or written.
    """
    wanted = _words(tags)
    archive = _archive(run)
    present = annotation_file.read(archive).tags
    if unknown := [tag for tag in wanted if tag not in present]:
        known = f": {', '.join(present)}" if present else "; it has none"
        raise AnnotationError(f"tag {', '.join(unknown)}: expected a tag of this run{known}")
    for tag in wanted:
        annotation_file.append(archive, "untag", tag)
    return annotation_file.path_of(archive)


def _words(tags: Iterable[str]) -> list[str]:
    """The tags, each once.

    Raises:
        AnnotationError: one is not a word, or they are one text instead of several.
    """
    if isinstance(tags, str) or not isinstance(tags, Iterable):
        raise AnnotationError(f"tags {tags!r}: expected a list of tags, such as ['bad']")
    given = list(tags)
    if wrong := [repr(tag) for tag in given if not (isinstance(tag, str) and _TAG.fullmatch(tag))]:
        raise AnnotationError(
            f"tag {', '.join(wrong)}: expected a word of at most 40 letters, digits, '_', '.' and '-'"
        )
    return list(dict.fromkeys(given))


def _archive(run: Path | str) -> Path:
    return Run(resolve(run)).path
