"""Conversion of one object file to a WebAssembly module.

LLVM's object file imports its memory and its stack pointer. With a single file, all indices and
addresses are final. So the imports become definitions, and the linker's sections are dropped.
https://webassembly.github.io/spec/core/binary
"""

from collections.abc import Iterator
from typing import NamedTuple

STACK = 64 * 1024  # [bytes] address of the stack's end, with constants below it
PAGES = 2  # initial pages of 64 KiB; the memory grows
_HEAD = b"\0asm\1\0\0\0"
# Sections in the order of a module.
(CUSTOM, TYPE, IMPORT, FUNCTION, TABLE, MEMORY, GLOBAL, EXPORT, START, ELEMENT, CODE, DATA,
 DATA_COUNT) = range(13)  # fmt: skip
_ORDER = (TYPE, IMPORT, FUNCTION, MEMORY, GLOBAL, EXPORT, DATA_COUNT, CODE, DATA)
_FUNCTIONS, _MEMORIES, _GLOBALS = 0, 2, 3  # kinds of imports and exports
# Linker's section: the symbol table, a flag, and kinds of symbols.
_SYMBOLS, _UNDEFINED, _DATA, _SECTION = 8, 0x10, 1, 3
_I32, _I32_CONST, _END, _MUTABLE = 0x7F, 0x41, 0x0B, 1


class _Reader:
    """Sequential reader of bytes."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.place = 0

    @property
    def ended(self) -> bool:
        """Return whether all bytes are read."""
        return self.place >= len(self._data)

    def take(self, count: int) -> bytes:
        """Read some bytes."""
        self.place += count
        return self._data[self.place - count : self.place]

    def number(self) -> int:
        """Read an unsigned LEB128 number."""
        value = shift = 0
        while True:
            (byte,) = self.take(1)
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value


class _Import(NamedTuple):
    """An import of the object file."""

    kind: int
    name: bytes
    written: bytes  # encoded import


def link(code: bytes, names: tuple[str, ...]) -> bytes:
    """Make a module from an object file; it exports `memory` and the named functions.

    Args:
        code: object file with symbols for its functions.
        names: names of the exported functions.
    """
    sections = {kind: body for kind, body in _sections(code) if kind != CUSTOM}
    places = dict(_symbols(code))
    if TABLE in sections or ELEMENT in sections:
        raise ValueError("code must not call functions by their address, got a table of them")
    imports = list(_imports(sections[IMPORT]))
    functions = [each.written for each in imports if each.kind == _FUNCTIONS]
    others = [each.name for each in imports if each.kind != _FUNCTIONS]
    if not set(others) <= {b"__linear_memory", b"__stack_pointer"}:
        raise ValueError(f"code must import functions, its memory and its stack, got {others}")
    sections[IMPORT] = _list(functions)
    sections[MEMORY] = _list([bytes([0, PAGES])])
    if b"__stack_pointer" in others:
        # A signed LEB128 number needs a zero sign bit; the power of two needs 17 bits.
        start = bytes([_I32, _MUTABLE, _I32_CONST]) + _unsigned(STACK) + bytes([_END])
        sections[GLOBAL] = _list([start])
    sections[EXPORT] = _list(
        [
            _name(b"memory") + bytes([_MEMORIES, 0]),
            *(
                _name(name.encode()) + bytes([_FUNCTIONS]) + _unsigned(places[name.encode()])
                for name in names
            ),
        ]
    )
    kept = [(each, sections[each]) for each in _ORDER if each in sections]
    return _HEAD + b"".join(bytes([k]) + _unsigned(len(body)) + body for k, body in kept)


def make_note(name: str, content: bytes) -> bytes:
    """Make a custom section for the end of a module. Engines ignore this section."""
    body = _name(name.encode()) + content
    return bytes([CUSTOM]) + _unsigned(len(body)) + body


def _sections(code: bytes) -> Iterator[tuple[int, bytes]]:
    """Read the sections of a file."""
    reader = _Reader(code)
    if reader.take(len(_HEAD)) != _HEAD:
        raise ValueError(f"code must be a WebAssembly object file, got {code[:8]!r}")
    while not reader.ended:
        (kind,) = reader.take(1)
        body = reader.take(reader.number())
        yield kind, body


def _symbols(code: bytes) -> Iterator[tuple[bytes, int]]:
    """Read names and indices of the functions defined in a file.

    https://github.com/WebAssembly/tool-conventions/blob/main/Linking.md
    """
    for kind, body in _sections(code):
        reader = _Reader(body)
        if kind != CUSTOM or reader.take(reader.number()) != b"linking":
            continue
        reader.number()  # version
        while not reader.ended:
            (part,) = reader.take(1)
            content = _Reader(reader.take(reader.number()))
            for _ in range(content.number() if part == _SYMBOLS else 0):
                (sort,) = content.take(1)
                is_defined = not content.number() & _UNDEFINED
                if sort == _DATA:
                    content.take(content.number())
                    for _ in range(3 if is_defined else 0):
                        content.number()
                    continue
                place = content.number()
                if is_defined and sort != _SECTION:
                    name = content.take(content.number())
                    if sort == _FUNCTIONS:
                        yield name, place


def _imports(body: bytes) -> Iterator[_Import]:
    reader = _Reader(body)
    for _ in range(reader.number()):
        first = reader.place
        reader.take(reader.number())  # the module's name
        name = reader.take(reader.number())
        (kind,) = reader.take(1)
        if kind == _FUNCTIONS:
            reader.number()  # its type
        elif kind == _GLOBALS:
            reader.take(2)  # its type and mutability
        elif kind == _MEMORIES:
            for _ in range(
                1 + (reader.number() & 1)
            ):  # minimum pages, and maximum pages if bounded
                reader.number()
        else:
            raise ValueError(f"code must import functions, its memory and its stack, got {name!r}")
        yield _Import(kind, name, body[first : reader.place])


def _list(items: list[bytes]) -> bytes:
    return _unsigned(len(items)) + b"".join(items)


def _name(name: bytes) -> bytes:
    return _unsigned(len(name)) + name


def _unsigned(value: int) -> bytes:
    """Encode an unsigned LEB128 number."""
    written = bytearray()
    while value >= 0x80:
        written.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*written, value])
