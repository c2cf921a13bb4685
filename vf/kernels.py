"""Compiling kernels, and a cache of them on disk that detects damage and changes.

Also what numba lacks: arrays by their address, bits of numbers, and the time.

Numba's own files are read unchecked: a truncated one makes every start fail, a flipped bit changes
machine code, and a changed callee is not noticed. Here each file
begins with a digest of its content, of what the kernel was made from, and of the versions it was
made with; a file that does not match counts as missing and is written anew.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from types import BuiltinFunctionType, CodeType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.caching import (
    CacheImpl,
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    UserProvidedCacheLocator,
)
from numba.core.dispatcher import Dispatcher
from numba.extending import _Intrinsic as Intrinsic
from numba.extending import intrinsic

SEAL = 32  # bytes
_said: set[str] = set()


def _pointer(kind: Any) -> Any:
    """An intrinsic that takes an address (int64) for a pointer to numbers of this kind."""

    def pointer(_context: Any, address: Any) -> Any:
        def code(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            llvm = _context.get_value_type(types.CPointer(kind))  # type: ignore[attr-defined]
            return builder.inttoptr(arguments[0], llvm)

        return types.CPointer(kind)(types.int64), code  # type: ignore[attr-defined]

    pointer.__name__ = f"pointer_to_{kind}"
    return intrinsic(pointer)


# For `numba.carray(floats_at(address), shape)`. Every array argument of a call from Python costs
# more time than some kernels take; an address within an array that is passed anyway costs nothing.
# Whoever stores an address keeps the array alive.
floats_at = _pointer(types.float64)
integers_at = _pointer(types.int64)
rows_at = _pointer(types.int32)
bytes_at = _pointer(types.int8)


@intrinsic
def lowest_bit(_context, mask):  # type: ignore[no-untyped-def]
    """Number of the lowest bit that is set in an integer, 64 if none is."""

    def code(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.cttz(arguments[0], ir.IntType(1)(0))

    return types.int64(types.int64), code


@intrinsic
def bits_as_float(_context, bits):  # type: ignore[no-untyped-def]
    """A float64 of the same 64 bits as an integer, to be stored, not computed with."""

    def code(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.bitcast(arguments[0], ir.DoubleType())

    return types.float64(types.int64), code


@intrinsic
def float_as_bits(_context, number):  # type: ignore[no-untyped-def]
    """The integer that `bits_as_float` was given."""

    def code(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.bitcast(arguments[0], ir.IntType(64))

    return types.int64(types.float64), code


@intrinsic
def now(_context):  # type: ignore[no-untyped-def]
    """Monotonic time [s], from the C library: what `time.monotonic` reads."""

    def code(_context, builder, _signature, _arguments):  # type: ignore[no-untyped-def]
        i32, i64 = ir.IntType(32), ir.IntType(64)
        place = cgutils.alloca_once(builder, ir.ArrayType(i64, 2))
        kind = ir.FunctionType(i32, [i32, place.type])
        read = cgutils.get_or_insert_function(builder.module, kind, "clock_gettime")
        builder.call(read, [i32(time.CLOCK_MONOTONIC), place])
        whole, rest = cgutils.unpack_tuple(builder, builder.load(place), 2)
        seconds = builder.sitofp(whole, ir.DoubleType())
        parts = builder.sitofp(rest, ir.DoubleType())
        return builder.fadd(seconds, builder.fmul(parts, ir.DoubleType()(1e-9)))

    return types.float64(), code


def njit(cache: bool, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` with this cache."""

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(**options)(function)
        if cache:
            try:
                dispatcher._cache = _Cache(function)
            except (RuntimeError, OSError):
                _say("kernels are compiled anew at every start: no folder for them can be written")
        return dispatcher

    return compiled


def ingredients(function: Callable[..., Any]) -> Iterator[bytes]:
    """All that a kernel's machine code depends on: its own code, constants, and its callees'.

    Raises:
        TypeError: it uses something global that is no number, array or kernel of its own.
    """
    waiting, seen = [function], {function}
    while waiting:
        kernel = waiting.pop()
        for code in _codes(kernel.__code__):
            constants = [c for c in code.co_consts if not isinstance(c, CodeType)]
            yield repr((code.co_code, code.co_names, code.co_varnames, constants)).encode()
            for name, value in _globals(kernel, code):
                if isinstance(value, Dispatcher):
                    if value.py_func not in seen:
                        seen.add(value.py_func)
                        waiting.append(value.py_func)
                elif isinstance(value, Intrinsic):
                    for part in _codes(value._defn.__code__):
                        yield part.co_code + repr(value).encode()
                elif isinstance(value, np.ndarray):
                    yield repr((name, value.dtype, value.shape)).encode() + value.tobytes()
                elif isinstance(value, int | float | str | tuple):
                    yield repr((name, value)).encode()
                elif value is not None and not isinstance(value, ModuleType | BuiltinFunctionType):
                    raise TypeError(f"{kernel.__name__} uses {name}: a kernel may not")


def _globals(function: Callable[..., Any], code: CodeType) -> Iterator[tuple[str, Any]]:
    """Names and values of what a function's code takes from its module, and from modules there.

    Of another module (`at.PLANE`) the constants and kernels, as far as the code has such names.
    """
    modules = []
    for name in code.co_names:
        value = function.__globals__.get(name)
        yield name, value
        if isinstance(value, ModuleType):
            modules.append(value)
    for module in modules:
        for name in code.co_names:
            value = vars(module).get(name)
            if isinstance(value, Dispatcher | int | float | str | tuple):
                yield f"{module.__name__}.{name}", value


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


class _SealedFiles(IndexDataCacheFile):
    """The files of one kernel: an index, and one for each kind of arguments."""

    def __init__(self, cache_path: str, filename_base: str, function: Callable[..., Any]) -> None:
        super().__init__(cache_path, f"{filename_base}.sealed", None)
        self._function = function

    @cached_property
    def _origin(self) -> bytes:
        # Not before the first call: a kernel may call others that are defined after it.
        versions = (numba.__version__, llvmlite.__version__, numba.config.BOUNDSCHECK)
        digest = hashlib.blake2b(repr(versions).encode(), digest_size=SEAL)
        for part in ingredients(self._function):
            digest.update(part)
        return digest.digest()

    def _seal(self, name: str, content: bytes) -> bytes:
        digest = hashlib.blake2b(content, digest_size=SEAL, key=self._origin)
        digest.update(name.encode())  # so that no file can stand for another
        return digest.digest()

    def _write(self, path: str, value: object) -> None:
        content = self._dump(value)
        with self._open_for_write(path) as file:
            file.write(self._seal(os.path.basename(path), content) + content)

    def _read(self, path: str) -> Any:
        """What was written there, or None."""
        try:
            data = Path(path).read_bytes()
        except OSError:
            return None
        content = data[SEAL:]
        if data[:SEAL] != self._seal(os.path.basename(path), content):
            return None
        try:
            return pickle.loads(content)
        except Exception:  # it names a module or a class that has moved since
            return None

    def _load_index(self) -> dict[object, str]:
        return self._read(self._index_path) or {}

    def _save_index(self, overloads: dict[object, str]) -> None:
        self._write(self._index_path, overloads)

    def _load_data(self, name: str) -> Any:
        return self._read(self._data_path(name))

    def _save_data(self, name: str, data: object) -> None:
        self._write(self._data_path(name), data)

    def save(self, key: object, data: object) -> None:
        super().save(key, (key, data))

    def load(self, key: object) -> Any:
        # Two processes that save at once may give two kernels' kinds the same name.
        found = super().load(key)
        return found[1] if found is not None and found[0] == key else None


class _Temporary(UserProvidedCacheLocator):
    """Where neither the installation nor the home can be written: a folder of the user's own."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        self._py_file = file
        self._lineno = function.__code__.co_firstlineno
        self._root = Path(tempfile.gettempdir()) / f"vf-kernels-{os.getuid()}"
        self._cache_path = str(self._root / self.get_suitable_cache_subpath(file))

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> _Temporary | None:
        try:
            self = cls(function, file)
            self._root.mkdir(mode=0o700, exist_ok=True)
            about = self._root.lstat()
            # Machine code is loaded from there: no other user may be able to write it.
            if about.st_uid != os.getuid() or about.st_mode & 0o077 or self._root.is_symlink():
                return None
            self.ensure_cache_path()
        except OSError:
            return None
        _say(f"compiled kernels are kept in {self._root}: no other folder for them can be written")
        return self


class _Place(CompileResultCacheImpl):
    _locator_classes = (*CacheImpl._locator_classes, _Temporary)


class _Cache(FunctionCache):
    _impl_class = _Place

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        base = self._impl.filename_base
        self._cache_file = _SealedFiles(self._cache_path, base, function)

    def save_overload(self, sig: object, data: object) -> None:
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _say(f"a compiled kernel could not be kept: {error}")


def _say(what: str) -> None:
    """A warning, once."""
    if what not in _said:
        _said.add(what)
        warnings.warn(what, RuntimeWarning, stacklevel=4)
