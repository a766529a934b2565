"""Matches simultaneous pictures of several cameras by the numbers in their names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import PurePath

from calibration.camera import CalibrationError


def keys(names: Mapping[str, Sequence[str]]) -> dict[str, dict[str, str]]:
    """Key of each picture, by camera and picture's name; pictures of one moment have the same key.

    The rightmost number that differs between all pictures of each camera is the moment's (left07.jpg and right07.jpg;
    0007_cam1.png and 0007_cam2.png). Without such a number equal names belong together, and at last the order where
    every camera has as many pictures.

    Raises:
        CalibrationError: the names do not match.
    """
    if len(names) == 1:
        return {camera: {name: name for name in listed} for camera, listed in names.items()}
    numbers = {camera: {name: re.findall(r"\d+", _stem(name)) for name in listed} for camera, listed in names.items()}
    deepest = max((len(n) for listed in numbers.values() for n in listed.values()), default=0)
    for back in range(1, deepest + 1):
        tried = {
            camera: {name: str(int(n[-back])) for name, n in listed.items() if len(n) >= back}
            for camera, listed in numbers.items()
        }
        complete = all(len(tried[camera]) == len(names[camera]) for camera in names)
        distinct = all(len(set(found.values())) == len(found) for found in tried.values())
        if complete and distinct and _overlap(tried) > 1:
            return tried
    stems = {camera: {name: _stem(name) for name in listed} for camera, listed in names.items()}
    if _overlap(stems) > 1:
        return stems
    if len({len(listed) for listed in names.values()}) == 1:
        return {camera: {name: str(k + 1) for k, name in enumerate(listed)} for camera, listed in names.items()}
    counts = ", ".join(f"{camera} {len(listed)}" for camera, listed in names.items())
    raise CalibrationError(
        f"which pictures belong to one moment cannot be told ({counts}): name them by a common number, "
        "as left07.jpg and right07.jpg"
    )


def _stem(name: str) -> str:
    """A picture's name without its suffix; a video's frame by its number."""
    video, hash_sign, frame = name.rpartition("#")
    return frame if hash_sign else PurePath(video or name).stem


def _overlap(found: Mapping[str, Mapping[str, str]]) -> int:
    """The fewest keys that a camera shares with any other."""
    least = []
    for camera, own in found.items():
        others = {key for other, listed in found.items() if other != camera for key in listed.values()}
        least.append(len(set(own.values()) & others))
    return min(least)
