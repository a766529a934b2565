"""Pictures to calibrate from: a folder of images, or a video, each with a name and a fingerprint."""

from __future__ import annotations

import hashlib
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from calibration.images import Image

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm"})
VIDEO_SUFFIXES = frozenset({".avi", ".mp4", ".mkv", ".mov"})


class ViewsError(Exception):
    """There is nothing to calibrate from; the message says what was looked for."""


@dataclass(frozen=True)
class View:
    """One grey picture (height, width); `sha256` is that of the image's file, or of a video frame's pixels."""

    name: str
    image: Image
    sha256: str


def views_in(source: Path, every: int = 1) -> Generator[View, None, None]:
    """Yield the pictures of a folder or of a pattern such as views/left*.jpg, by name, or every so many video frames.

    Raises:
        ViewsError: the source does not exist, or holds no picture.
    """
    if source.is_dir():
        files = sorted(p for p in source.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES)
        if not files:
            raise ViewsError(f"{source} holds no picture ({', '.join(sorted(IMAGE_SUFFIXES))})")
        yield from _pictures(files)
    elif source.is_file() and source.suffix.lower() in VIDEO_SUFFIXES:
        yield from _frames(source, every)
    elif any(sign in source.name for sign in "*?[") and not source.exists():
        files = sorted(p for p in source.parent.glob(source.name) if p.suffix.lower() in IMAGE_SUFFIXES)
        if not files:
            raise ViewsError(f"{source} matches no picture ({', '.join(sorted(IMAGE_SUFFIXES))})")
        yield from _pictures(files)
    elif source.exists():
        raise ViewsError(f"{source} is neither a folder nor a video ({', '.join(sorted(VIDEO_SUFFIXES))})")
    else:
        raise ViewsError(f"{source} does not exist")


def _pictures(files: list[Path]) -> Generator[View, None, None]:
    for file in files:
        data = file.read_bytes()
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
        if image is None:
            raise ViewsError(f"{file} is not a picture that can be read")
        yield View(file.name, np.asarray(image, dtype=np.uint8), hashlib.sha256(data).hexdigest())


def _frames(video: Path, every: int) -> Generator[View, None, None]:
    capture = cv2.VideoCapture(str(video))
    try:
        index = 0
        while True:
            ok, image = capture.read()
            if not ok:
                break
            if index % every == 0:
                grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
                yield View(f"{video.name}#{index}", grey, hashlib.sha256(grey.tobytes()).hexdigest())
            index += 1
        if index == 0:
            raise ViewsError(f"{video} is not a video that can be read")
    finally:
        capture.release()
