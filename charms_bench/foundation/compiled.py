"""How the project compiles, and the arithmetic that compiled code shares."""

import math
import re
import sys
from contextlib import suppress
from functools import cache, update_wrapper
from hashlib import sha256
from importlib.util import resolve_name
from inspect import getfile
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.experimental import structref
from numba.extending import intrinsic

from charms_bench.errors import InputError

F = TypeVar("F")

if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]  # made from the environment
    raise InputError("NUMBA_DISABLE_JIT is set, but the engine has to be compiled; unset it")


_IMPORT = re.compile(r"^(?:from +([\w.]+) +import +(\([^)]*\)|.*)|import +(.*))", re.MULTILINE)
"""An import statement that runs when its module does, on one line or in parentheses."""


@cache
def _source(name: str, file: Path) -> tuple[bytes, list[str]]:
    """The hash of a module's source, and the names of what it imports."""
    code, found = file.read_bytes(), []
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    for origin, members, plain in _IMPORT.findall(code.decode(errors="replace")):
        names = [
            words[0]
            for each in (members or plain).strip("()").split(",")
            if (words := each.split())
        ]
        if origin:
            origin = resolve_name(origin, package)
            names = [origin, *(f"{origin}.{each}" for each in names)]
        found += names
    return sha256(code).digest(), found


@cache
def _file_of(name: str) -> Path | None:
    """The file of a module, found through the package that it is part of; None if it has none."""
    package, *parts = name.split(".")
    for folder in getattr(sys.modules.get(package), "__path__", ()):
        path = Path(folder, *parts)
        for file in (path / "__init__.py", path.with_suffix(".py")):
            if file.is_file():
                return file
    return None


@cache
def _code_hash(module: str, file: str) -> str:
    """The hash of a module's source and of all that it imports from its own package and this one.

    A compiled function contains those that it calls, and the constants that it names.
    """
    packages = {each.partition(".")[0] for each in (__name__, module)}
    waiting, digests = {module: Path(file)}, {}
    while waiting:
        name, path = waiting.popitem()
        digests[name], imported = _source(name, path)
        for each in imported:
            if each.partition(".")[0] in packages and each not in digests:
                waiting |= {each: found} if (found := _file_of(each)) else {}
    return sha256(b"".join(digests[name] for name in sorted(digests))).hexdigest()


class _Cache(FunctionCache):
    """numba's cache of a function, in which a damaged file or a full disk does not matter.

    A function contains those that it calls, so a change of any of them makes it obsolete. numba
    itself would notice changes of the function's own file only.
    """

    def __init__(self, function: Any) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        module = function.__module__
        # In place of numba's stamp, which may be the file's time.
        stamp = _code_hash(module, getfile(function))
        folder, locator = self._cache_path, self._impl.locator
        if numba.config.CACHE_DIR:  # type: ignore[attr-defined]  # made from the environment
            # The same code has the same folder, wherever it is installed.
            folder = str(Path(folder).with_name(f"{module}-{stamp[:16]}"))
            self._cache_path = locator._cache_path = folder
        self._cache_file = IndexDataCacheFile(folder, self._impl.filename_base, stamp)  # type: ignore[no-untyped-call]

    def load_overload(self, *of: Any) -> Any:
        """The function as it was compiled; None if it has to be compiled."""
        try:
            return super().load_overload(*of)  # type: ignore[no-untyped-call]
        except Exception:  # a damaged pickle can raise anything
            with suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
            return None

    def save_overload(self, *of: Any) -> None:
        """Keeps the compiled function if it can be written."""
        with suppress(OSError):
            super().save_overload(*of)  # type: ignore[no-untyped-call]

    def is_filled(self, processor: Any) -> bool:
        """Whether a version of the function as it is now is kept, for a processor."""
        try:
            keys = self._cache_file._load_index()  # type: ignore[no-untyped-call]
        except Exception:  # a damaged pickle can raise anything
            return False
        return any(key[1] == processor for key in keys)


class _InnerCache(_Cache):
    """The cache of what only compiled code calls, which Python must never find: it would crash."""

    def _index_key(self, *of: Any) -> Any:
        return (*super()._index_key(*of), "inner")  # type: ignore[no-untyped-call]


def compiled(function: F) -> F:
    """Compiles at the first call, caches on disk, releases the GIL; never uses fastmath.

    Raises:
        InputError: There is no folder for the cache.
    """
    return cast(F, _compiled(function))


def inlined(function: F) -> F:
    """Compiles like `compiled`, and into each of its callers, so that their loops vectorise."""
    return cast(F, _compiled(function, forceinline=True))


def woven(function: F) -> F:
    """Repeats the code of a function in its callers: compiled code cannot return a row of a table.

    Such a function calls only compiled functions or others like it.
    """
    njit: Any = numba.njit
    return cast(F, njit(inline="always")(function))


def _compiled(function: Any, forceinline: bool = False) -> Any:
    """A function that Python and compiled code can call; each compiles its own version.

    What makes a function callable from Python unpacks its arguments. For a function of a scene,
    it takes longer to compile than the function, and compiled code has no use for it.
    """
    called = _dispatcher(_Cache, function, forceinline=forceinline)
    inner = _dispatcher(
        _InnerCache,
        function,
        forceinline=forceinline,
        no_cpython_wrapper=True,
        no_cfunc_wrapper=True,
    )
    called.get_call_template, called.get_overload = inner.get_call_template, inner.get_overload
    return called


def _dispatcher(cache: type[FunctionCache], function: Any, **options: bool) -> Any:
    njit: Any = numba.njit
    found = njit(nogil=True, error_model="numpy", **options)(function)
    try:
        found._cache = cache(function)  # as `cache=True` does
    except RuntimeError as error:
        raise InputError(
            "compiled code cannot be kept: neither the installed package nor the home folder can "
            "be written to; set NUMBA_CACHE_DIR to a folder that can"
        ) from error
    return found


@structref.register
class _UnpackedType(types.StructRef):
    """The type of `Unpacked` in compiled code."""


class Unpacked(structref.StructRefProxy):
    """A scene as compiled code holds it, in the one field `scene`.

    At every call, numba looks up the types of all arrays and constants of a scene and unpacks them,
    which takes 6 µs. Of this object, it unpacks one pointer. And it counts references of arrays
    whenever one is named, which takes longer than most of what is computed; those of `scene` are
    `borrowed`, and the object keeps the arrays while it lives.
    """

    arrays: tuple[Any, ...]


structref.define_proxy(Unpacked, _UnpackedType, ["scene"])  # type: ignore[no-untyped-call]


def _borrowed(_: Any, scene: Any) -> Any:
    def borrow(context: Any, builder: Any, kind: Any, value: Any) -> Any:
        if isinstance(kind, types.Array):
            array = context.make_array(kind)(context, builder, value)
            array.meminfo = cgutils.get_null_value(array.meminfo.type)  # type: ignore[no-untyped-call]
            array.parent = cgutils.get_null_value(array.parent.type)  # type: ignore[no-untyped-call]
            return array._getvalue()
        if not isinstance(kind, types.BaseTuple):
            context.nrt.incref(builder, kind, value)
            return value
        parts: Any = kind
        for k, each in enumerate(parts):
            part = borrow(context, builder, each, builder.extract_value(value, k))
            value = builder.insert_value(value, part, k)
        return value

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return borrow(context, builder, *signature.args, *arguments)

    return scene(scene), generate


borrowed: Any = intrinsic(_borrowed)
"""`borrowed(scene)`, in compiled code, is a tuple whose arrays, also those of tuples in it, have no
owner, so that their references are not counted. Something else has to keep the arrays: `scene` is
an argument that Python holds, never a variable of compiled code. And such an array must not reach
Python, so compiled functions return copies."""


def unpack_with(compiled_unpack: Any, scene: Any) -> Unpacked:
    """What a compiled function unpacks of a scene, with the arrays that it borrows."""
    found: Unpacked = compiled_unpack(scene)
    found.arrays = tuple(scene)
    return found


@compiled
def _unpack(scene: Any) -> Unpacked:
    return Unpacked(borrowed(scene))  # type: ignore[no-untyped-call]


def unpacked(scene: Any) -> Unpacked:
    """Unpacks a scene; see `Scene.unpacked`."""
    return unpack_with(_unpack, scene)


def _call(unpacked: Any, *others: Any) -> Any:
    """What Python calls instead of `_function`, which `compiled_of_scenes` fills in."""
    return _function(unpacked.scene, *others)  # type: ignore[name-defined]  # noqa: F821


def compiled_of_scenes(function: F) -> F:
    """Compiles like `compiled` a function of a scene that Python calls often.

    Compiled code cannot call it.
    """
    plain: Any = function
    # numba's cache finds this file by it, and compiles again when the file has changed.
    code = _call.__code__.replace(co_filename=plain.__code__.co_filename)
    entry: Any = update_wrapper(FunctionType(code, {"_function": compiled(function)}), plain)
    del entry.__wrapped__
    call = compiled(entry)

    def of_scene(scene: Any, *others: Any) -> Any:
        return call(scene.unpacked, *others)

    of_scene.compiled = call  # type: ignore[attr-defined]
    return cast(F, update_wrapper(of_scene, plain))


def is_kept(function: Any) -> bool:
    """Whether an earlier process has compiled a function of a scene, for this processor."""
    call = function.compiled
    return bool(call._cache.is_filled(call.targetctx.codegen().magic_tuple()))


def _row_after(_: Any, row: Any, count: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        first, number = arguments
        number = context.cast(builder, number, signature.args[1], types.intp)
        size = context.get_constant(types.intp, row.size)
        offset: Any = builder.mul(number, size)
        return cgutils.pointer_add(  # type: ignore[no-untyped-call]
            builder, first, offset, first.type
        )

    return row(row, count), generate


row_after: Any = intrinsic(_row_after)
"""`row_after(row, count)`, in compiled code, is the row of a table `count` rows after `row`.

Compiled code passes a row as one pointer, but an array as seven numbers or more, whose references
it counts; for small functions, that takes longer than what they compute. Nothing checks that there
is such a row, and the table has to outlive its rows."""


@inlined
def index(value: int) -> Any:
    """An index that is not negative, as a type for which compiled code need not check that.

    Do not compute with it: in compiled code, its sum with an integer is a float.
    """
    return np.uint64(value)


@compiled
def clip(value: float, low: float, high: float) -> float:
    """The value, or the bound that it exceeds."""
    return min(max(value, low), high)


@compiled
def not_zero(value: float) -> float:
    """A divisor at least 0.01 away from zero [`utils.not_zero`]."""
    if abs(value) > 1e-2:
        return value
    return 1e-2 if value >= 0 else -1e-2


@compiled
def wrap_to_pi(angle: float) -> float:
    """The same direction as an angle from -pi to pi [`utils.wrap_to_pi`]."""
    shifted = angle + math.pi
    if not 0 <= shifted < 2 * math.pi:
        shifted %= 2 * math.pi
    return shifted - math.pi
