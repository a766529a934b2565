"""Readers of the buffer of a task."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import InStream, _values


class AnalogMultiChannelReader:
    """Reads several analogue inputs."""

    def __init__(self, task_in_stream: InStream) -> None:
        self._task = task_in_stream.task

    def read_many_sample(
        self, data: np.ndarray[Any, Any], number_of_samples_per_channel: int = -1, timeout: float = 10.0
    ) -> int:
        """Fill data (channels, scans); input k reads output k."""
        task = self._task
        assert data.shape == (len(task.channels), number_of_samples_per_channel)
        stands = _values(task.device)
        data[:] = np.array([stands[number] for number, _, _ in task.channels])[:, None]
        task.read_scans += number_of_samples_per_channel
        return number_of_samples_per_channel
