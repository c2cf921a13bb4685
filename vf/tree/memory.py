"""Memory of large arrays that is used again."""

from __future__ import annotations

from sys import getrefcount

import numpy as np

from vf.planes import FloatArray


class Memory:
    """Arrays of one size, given out anew when nobody refers to them any more.

    Fresh memory costs as much as what is written to it: the system clears its pages.
    """

    def __init__(self, most: int) -> None:
        """`most`: so many arrays are kept to be given out again."""
        self._most = most
        self._arrays: list[FloatArray] = []

    def array(self, shape: tuple[int, ...]) -> FloatArray:
        """An array of that shape, which is the same at every call.

        What is given out is a view, and so are views of that: each refers to its base. An array
        that is looked at here is out of the list, so that no two threads look at the same.
        """
        for _ in range(len(self._arrays)):
            try:
                array = self._arrays.pop(0)
            except IndexError:  # another thread has it
                break
            alone = getrefcount(array) == _ALONE
            view = array[:]
            self._arrays.append(array)
            if alone:
                return view
        array = np.empty(shape)
        view = array[:]
        if len(self._arrays) < self._most:
            self._arrays.append(array)
        return view


def _alone() -> int:
    """What `getrefcount` says of an array that only a local variable refers to."""
    array = [np.empty(1)].pop(0)
    return getrefcount(array)


_ALONE = _alone()
