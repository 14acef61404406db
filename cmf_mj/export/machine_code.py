"""Machine code of compiled functions in object files that a linker takes, without Python.

A compiled function takes named tuples of numbers and arrays. Here it is called with the address of
a table instead, of slots of 8 bytes in the order of `leaves`,

    a number     one slot
    an array     its address, its shape and its strides: 1 + 2 ndim slots
    None         no slot

from which the tuples are built again at each call. Numba makes the LLVM code of the function and of
all it calls; from this everything that serves Python is removed, and LLVM writes position
independent code for `PROCESSOR`. Multiplications and additions are fused in neither, so that the
bits are the same on every processor; sine, power and the like are those of the C library.

The loop takes a minute and a half to compile and is the same for every plant, law, rate and
electronics, which are data. So object files are kept.
"""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

import llvmlite.binding as llvm
import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numba.np import arrayobj
from numpy.typing import NDArray

from cmf_mj.core.compiled import assign, digest
from cmf_mj.core.errors import RunError
from cmf_mj.core.files import whole_file

PROCESSOR = "x86-64-v2"  #: Least processor the code runs on: any of the x86-64 family since 2009.

_WORD = ir.IntType(64)

_OPTIONS = {"nogil": True, "error_model": "numpy", "_nrt": False}  #: Those of `core.compiled`.

KNOWN = frozenset(
    ["memcpy", "memmove", "memset", "fabs", "floor", "ceil", "trunc", "rint", "round"]
    + ["sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp", "expm1", "log"]
    + ["log1p", "pow", "sinh", "cosh", "tanh", "fmod", "fmin", "fmax", "hypot", "ldexp"]
)
"""Functions of the C library that the code may call."""


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Numbers and arrays of nested tuples in the order of the slots, with their dotted paths."""
    if isinstance(value, tuple):
        names = getattr(value, "_fields", range(len(value)))
        for name, part in zip(names, value, strict=True):
            yield from leaves(part, f"{path}.{name}" if path else str(name))
    elif value is not None:
        yield path, value


class _Reader:
    """Builds values of Numba's types from the table at an address, slot by slot."""

    def __init__(self, context: Any, builder: Any, address: Any) -> None:
        self.context, self.builder, self.next_slot = context, builder, 0
        self.table = builder.inttoptr(address, _WORD.as_pointer())

    def read_word(self) -> Any:
        """The next slot."""
        place = self.builder.gep(self.table, [ir.Constant(_WORD, self.next_slot)])
        self.next_slot += 1
        return self.builder.load(place)

    def read_value(self, kind: Any) -> Any:
        """A value of Numba's type `kind` from as many slots as it has."""
        context, builder = self.context, self.builder
        if isinstance(kind, types.BaseTuple):
            return context.make_tuple(builder, kind, [self.read_value(part) for part in kind])
        if isinstance(kind, types.NoneType):
            return context.get_dummy_value()
        if isinstance(kind, types.Array):
            return self.read_array(kind)
        if kind == types.float64:
            return builder.bitcast(self.read_word(), ir.DoubleType())
        if kind == types.int64:
            return self.read_word()
        if kind == types.boolean:
            return builder.icmp_unsigned("!=", self.read_word(), ir.Constant(_WORD, 0))
        raise RunError(f"machine code: a parameter of type {kind} has no slot")

    def read_array(self, kind: Any) -> Any:
        """An array, which stays where its address says."""
        context, builder = self.context, self.builder
        result = arrayobj.make_array(kind)(context, builder)
        item = context.get_data_type(kind.dtype)
        data = builder.inttoptr(self.read_word(), item.as_pointer())
        shape = [self.read_word() for _ in range(kind.ndim)]
        strides = [self.read_word() for _ in range(kind.ndim)]
        size = context.get_constant(types.intp, context.get_abi_sizeof(item))
        arrayobj.populate_array(result, data, shape, strides, size, None)
        return result._getvalue()


def _compile_for_table(function: Callable[..., Any], kind: Any) -> Any:
    """`function(parts, first, last)`, compiled to be called with the address of their slots."""

    @intrinsic
    def read(typing_context: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            return _Reader(context, builder, arguments[0]).read_value(kind)

        return kind(types.intp), generate

    called = numba.njit(**_OPTIONS)(function)

    def entry(slots, first, last):  # type: ignore[no-untyped-def]
        called(read(slots), first, last)

    signature = types.void(types.intp, types.intp, types.intp)
    return numba.njit([signature], **_OPTIONS)(entry).overloads[signature.args]


@lru_cache
def _target() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_triple(llvm.get_default_triple())
    return target.create_target_machine(
        cpu=PROCESSOR, features="", opt=3, reloc="pic", codemodel="small"
    )


def machine_code(name: str, function: Callable[..., Any], kind: Any) -> bytes:
    """An object file with one function of C.

        int name(void **result, void **fault, int64_t slots, int64_t first, int64_t last)

    It calls `function(parts, first, last)`, where Numba's type of the parts is `kind`. It allocates
    nothing; both pointers must be there and are not used.
    Raises `RunError` if it needs other functions than those `KNOWN`: Numba has changed.
    """
    files = Path(__file__), Path(function.__code__.co_filename)
    sources = [*(file.read_text(encoding="utf-8") for file in files)]
    sources += [version("numba"), version("llvmlite")]
    key = (function.__qualname__, repr(kind))
    return load_or_make(name, key, sources, lambda: _compile(name, function, kind))


def _compile(name: str, function: Callable[..., Any], kind: Any) -> bytes:
    """Compile what `machine_code` keeps."""
    overload = _compile_for_table(function, kind)
    module = llvm.parse_assembly(overload.library.get_llvm_str())
    entry = overload.fndesc.llvm_func_name
    for number, symbol in enumerate([*module.functions, *module.global_variables]):
        if symbol.name == entry:
            symbol.name, symbol.linkage, symbol.visibility = name, "external", "hidden"
        elif not symbol.is_declaration:
            symbol.name, symbol.linkage = f"{name}_{number}", "internal"
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.add_strip_dead_prototype_pass()
    target = _target()
    passes.run(module, llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options()))
    module.verify()
    declared = {function.name for function in module.functions if function.is_declaration}
    unknown = {symbol for symbol in declared if not symbol.startswith("llvm.")} - KNOWN
    if unknown:
        calls = ", ".join(sorted(unknown))
        raise RunError(f"machine code of {name}: calls {calls}; Numba has changed")
    return bytes(target.emit_object(module))


def constant_data(blocks: dict[str, NDArray[np.uint8]]) -> bytes:
    """An object file with constant bytes by their C names, aligned to 64."""
    module = ir.Module(name="data")
    for name, block in blocks.items():
        kind = ir.ArrayType(ir.IntType(8), block.size)
        variable = ir.GlobalVariable(module, kind, name)
        variable.initializer = ir.Constant(kind, bytearray(block.tobytes()))
        variable.global_constant, variable.align = True, 64
    parsed = llvm.parse_assembly(str(module))
    for variable in parsed.global_variables:
        variable.visibility = "hidden"
    return bytes(_target().emit_object(parsed))


def load_or_make(
    name: str, key: Sequence[str], sources: Sequence[str], make: Callable[[], bytes]
) -> bytes:
    """Bytes that `make` makes for a `key` by these `sources` and all compiled code.

    They are kept in a file; those of one name that other sources made are thrown away.
    """
    source_hash, key_hash = _hash([digest(), *sources]), _hash(key)
    folder = Path(cast("Any", assign).stats.cache_path)
    file = folder / f"{name}-{source_hash}-{key_hash}.o"
    if not file.is_file():
        content = make()
        for old in set(folder.glob(f"{name}-*.o")) - set(folder.glob(f"{name}-{source_hash}-*.o")):
            old.unlink(missing_ok=True)
        with whole_file(file) as partial:
            partial.write_bytes(content)
    return file.read_bytes()


def _hash(texts: Sequence[str]) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:12]
