"""Checks of numbers and arrays, arrays and tables that are read-only, and arguments of kernels."""

import operator
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, NoReturn, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.errors import InputError, unknown_name

BlockT = TypeVar("BlockT", bound=tuple[Any, ...])
ParamsT = TypeVar("ParamsT", bound=tuple[Any, ...])

LARGEST_PART = 4 * 2**30  #: Size of the largest part of a run, such as its record [bytes].


def check_memory(field: str, part: str, numbers: float) -> None:
    """Refuse a part of a run with too many numbers of 8 bytes, before any of it is made."""
    size = 8.0 * numbers
    if size > LARGEST_PART:
        raise InputError(
            f"{field}: {part} would take {size / 2**30:.3g} GiB; "
            f"allowed: {LARGEST_PART / 2**30:g} GiB"
        )


def whole(name: str, value: Any, least: int, most: int) -> int:
    """A whole number of Python in its bounds, of one of NumPy too; others are refused by name."""
    try:
        number = operator.index(value)
    except TypeError:
        number = least - 1
    if isinstance(value, bool | np.bool_) or not least <= number <= most:
        raise InputError(
            f"{name}: {value!r} is refused; allowed: a whole number from {least} to {most}"
        )
    return number


def real(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Values as an array of floats; refused under their name where they are not real numbers."""
    try:
        array = np.asarray(values)
        if array.dtype.kind in "biuf":
            return np.asarray(array, dtype=float)
        content = str(array.dtype)
    except ValueError:
        content = "rows of different lengths"
    raise InputError(f"{name}: holds {content}; allowed: real numbers")


def shaped(
    name: str, values: ArrayLike, *shape: int | None, leading: bool = False
) -> NDArray[np.float64]:
    """A copy of finite numbers of a shape, in which None is any length; else refused by name.

    With `leading` axes of any lengths may go before.
    """
    array = np.array(real(name, values), order="C")
    last = array.shape[-len(shape) :] if leading else array.shape
    is_fitting = len(last) == len(shape) and all(
        size in (None, length) for size, length in zip(shape, last, strict=True)
    )
    if not is_fitting:
        sizes = ["N" if size is None else str(size) for size in shape]
        allowed = ", ".join(["..."] * leading + sizes) + "," * (len(sizes) + leading == 1)
        raise InputError(f"{name}: shape is {array.shape}; allowed: ({allowed})")
    if not np.isfinite(array).all():
        first = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InputError(f"{name}{list(first)}: {array[first]} is not a finite number")
    return array


def frozen(values: ArrayLike) -> NDArray[np.float64]:
    """A read-only view, which cannot be made writable, of the array itself or of a copy.

    It is a view of the array itself where that, or the array that it is a view of, owns its values
    and is read-only. So a long history is frozen once, handed over, and not held twice.
    """
    array = np.asarray(values)
    owner = array if array.base is None else array.base
    if not isinstance(owner, np.ndarray) or owner.flags.writeable or owner.size != array.size:
        array = np.array(array)
        array.setflags(write=False)
    view = array.view()
    view.setflags(write=False)
    return view


def copy_block(block: BlockT) -> BlockT:
    """A named tuple of arrays, and of such tuples, with arrays of its own."""
    parts = (copy_block(part) if isinstance(part, tuple) else part.copy() for part in block)
    return type(block)(*parts)


def compiled_params(kind: type[ParamsT], settings: object, **derived: Any) -> ParamsT:
    """The named tuple of a block: `derived` values, and the rest by name from settings.

    Settings are a mapping or an object. Quantities become their SI value, others stay as they are.

    >>> from cmf_mj.plant.cylinder import Friction
    >>> compiled_params(Friction, cmf_mj.load_hydraulics("report"), excess=0.1).presliding
    0.0001016
    """
    table = settings if isinstance(settings, Mapping) else vars(settings)
    fields = kind._fields  # type: ignore[attr-defined]
    values = {name: derived[name] if name in derived else table[name] for name in fields}
    return kind(**{name: getattr(value, "si", value) for name, value in values.items()})


def record_array(kind: type[NamedTuple], rows: Iterable[Any]) -> np.recarray:
    """Rows, each a `kind` or a list of them, as one array with the fields and types of `kind`.

    Compiled functions take every array of an argument apart into its seven words, so that forty
    arrays cost more to hand over than to use; one record array a kind costs one, and they write to
    it. `record_array(Cylinder, cylinders)[2]` reads like one `Cylinder`, and `.cap_area` is an
    array.
    """
    dtype = np.dtype([(name, kind.__annotations__[name]) for name in kind._fields])
    values = [[*map(tuple, row)] if isinstance(row, list) else tuple(row) for row in rows]
    return np.array(values, dtype=dtype).view(np.recarray)


def _refuse_change(self: object, *_: object, **__: object) -> NoReturn:
    raise TypeError(f"{type(self).__name__} does not support item assignment: it is read-only")


class FrozenDict(dict[str, Any]):
    """A mapping by name that nobody can write to; it pickles and copies."""

    __setitem__ = __delitem__ = __ior__ = _refuse_change
    clear = pop = popitem = setdefault = update = _refuse_change

    def __missing__(self, name: str) -> NoReturn:
        """Refuse a name that is not there."""
        raise unknown_name("field", name, self)

    def __reduce__(self) -> tuple[Any, ...]:
        """How to make it again."""
        return FrozenDict, (dict(self),)


class FrozenList(list[Any]):
    """A list that nobody can write to; it pickles and copies."""

    __setitem__ = __delitem__ = __iadd__ = __imul__ = _refuse_change
    append = extend = insert = pop = remove = _refuse_change
    clear = reverse = sort = _refuse_change

    def __reduce__(self) -> tuple[Any, ...]:
        """How to make it again."""
        return FrozenList, (list(self),)


_SCALARS = frozenset((str, float, int, bool, type(None)))


def frozen_json(content: Any) -> Any:
    """JSON values that nobody can write to, down to the last table and list; of NumPy too."""
    if isinstance(content, FrozenDict | FrozenList):
        return content
    if isinstance(content, np.ndarray | np.generic):
        return frozen_json(content.tolist())
    if isinstance(content, dict):
        return FrozenDict(zip(content, frozen_json(tuple(content.values())), strict=True))
    if isinstance(content, list | tuple):
        kind = FrozenList if isinstance(content, list) else tuple
        return kind(v if type(v) in _SCALARS else frozen_json(v) for v in content)
    return content
