"""Another process that plays while this one learns, so that both of two cores are in use."""

from concurrent.futures import ProcessPoolExecutor

import torch

_player = None


def _make(kind, arguments):
    global _player
    torch.set_num_threads(1)
    _player = kind(*arguments)


def _play(arguments):
    return _player.play(*arguments)


class Beside(ProcessPoolExecutor):
    """`kind(*arguments)` made in a process of its own."""

    def __init__(self, kind, *arguments):
        super().__init__(1, initializer=_make, initargs=(kind, arguments))

    def play(self, *arguments):
        """The future of what its `play` answers."""
        return self.submit(_play, arguments)
