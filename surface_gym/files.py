"""Files: atomic writing, and bounded reading with errors that name the problem.

Readers raise errors without the file's name, e.g. "it must be a file". Callers write the name
before the message.
"""

import hashlib
import itertools
import math
import os
import re
import stat
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from pickle import UnpicklingError
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

SUFFIX = ".part"  # suffix of an unfinished file
LINE = 2**20  # [bytes] maximum line of a text
TABLE = ARCHIVE = 4 * 2**30  # [bytes] on the disk
MEMBERS = 1000  # maximum members of an archive; the largest here has about fifty
SMALL = 2**24  # [bytes] unpacked size that is always allowed
RATIO = 200  # [-] maximum ratio of unpacked to packed size above that
CHECKSUM = b"sha256: "  # begins an archive's comment, before 64 hexadecimal digits
REASON = 300  # maximum characters of a description
# Errors of libraries for damaged files: text, YAML, JSON, zip, arrays, tensors.
DAMAGE = (
    ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, MemoryError,
    NotImplementedError, OSError, RuntimeError, SyntaxError, TypeError, UnpicklingError, ValueError,
    struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0,
}  # fmt: skip


@contextmanager
def replacing(file: Path) -> Iterator[Path]:
    """Yield a path for a new file, which replaces `file` at the end of the `with` block.

    If the block raises an error, `file` stays as it was.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(file.name + SUFFIX)
    yield part
    os.replace(part, file)


def describe_damage(error: Exception) -> str:
    """Describe in a short line why a file cannot be read. Cut off the long advice of libraries."""
    if isinstance(error, UnpicklingError):
        return "it holds more than tensors and plain values"
    if isinstance(error, KeyError) and len(error.args) == 1:
        return f"{error.args[0]!r:.60} is missing"
    if isinstance(error, RecursionError):
        return "it is nested too deep"
    text = " ".join(str(error).split()) or "it is cut short"
    return text if len(text) <= REASON else f"{text[:REASON]}..."


def refuse_constant(name: str) -> None:
    """Raise a ValueError for NaN or infinity.

    The function is the argument `parse_constant` of `json.loads`.
    """
    raise ValueError(f"numbers must be finite, got {name}")


def describe_at_line(error: Exception, number: int) -> str:
    """Describe an error in a text file. Add the line's `number` if the message has none."""
    reason = describe_damage(error)
    return reason if reason.startswith("line ") else f"line {number}: {reason}"


def check_plain(file: Path, most: int) -> None:
    """Raise a ValueError unless a file is a regular file of at most `most` bytes.

    Pipes and devices are refused, because reading them may never end.

    Raises:
        FileNotFoundError: the file does not exist.
    """
    try:
        found = file.stat()
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ValueError(f"it cannot be read ({error.strerror})") from None
    if not stat.S_ISREG(found.st_mode):
        what = "a folder" if stat.S_ISDIR(found.st_mode) else "a pipe or a device"
        raise ValueError(f"it must be a file, got {what}")
    if found.st_size > most:
        raise ValueError(f"it must have at most {most} bytes, got {found.st_size}")


def most_unpacked(packed: int) -> int:
    """Return the largest allowed size [bytes] after unpacking `packed` bytes."""
    return max(SMALL, RATIO * packed)


def read_bytes(file: Path, most: int) -> bytes:
    """Read a file of at most `most` bytes; errors are as in `read_lines`."""
    with _opened(file, most) as stream:
        return stream.read(most)


def read_text(file: Path, most: int) -> str:
    """Read text (UTF-8, without NULs) of at most `most` bytes; errors are as in `read_lines`."""
    return _decode(read_bytes(file, most))


def read_lines(file: Path, cut: str = r"(?!)") -> Iterator[str]:
    """Yield the lines of a text (UTF-8) with their line breaks; an error names the line.

    Args:
        cut: regular expression for an incomplete last line, e.g. from a killed writer. A last
            line without a line break is skipped if the line matches `cut`.

    Raises:
        ValueError: the file is not a text, or its last line is incomplete and not skipped.
        FileNotFoundError: the file does not exist.
    """
    with _opened(file, TABLE) as stream:
        for number in itertools.count(1):
            line = stream.readline(LINE)
            if not line.endswith(b"\n"):
                if len(line) == LINE:
                    raise ValueError(f"line {number} must have less than {LINE} bytes, got more")
                if line and not re.fullmatch(cut, _decode(line, f"line {number}: ")):
                    raise ValueError(
                        f"line {number} is cut: it must end in a line break; "
                        f"{number - 1} whole lines stand before it"
                    )
                return
            yield _decode(line, f"line {number}: ").removeprefix("" if number > 1 else "\ufeff")


def _open(file: Path, most: int) -> IO[bytes]:
    check_plain(file, most)
    try:
        return file.open("rb")
    except OSError as error:
        raise ValueError(f"it cannot be read ({error.strerror})") from None


@contextmanager
def _opened(file: Path, most: int) -> Iterator[IO[bytes]]:
    with _open(file, most) as stream:
        try:
            yield stream
        except OSError as error:
            raise ValueError(f"it cannot be read ({error.strerror})") from None


def _decode(content: bytes, where: str = "") -> str:
    if b"\0" in content:
        raise ValueError(f"{where}it is not text: byte {content.index(0) + 1} is NUL")
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        raise ValueError(f"{where}it is not UTF-8 text: byte {error.start + 1}") from None


def check_archive(stream: IO[bytes], stored: int | None = None) -> zipfile.ZipFile:
    """Open a zip archive. If this package cannot have written the archive, raise an error.

    Args:
        stored: for an archive of tensors, the maximum total size [bytes] of members without
            tensors. If `stored` is given, no member may be compressed, and all checksums are
            verified.
    """
    size = stream.seek(0, os.SEEK_END)
    stream.seek(0)
    if not zipfile.is_zipfile(stream):
        raise ValueError("it is no archive, or only the beginning of one")
    stream.seek(0)
    if sum(part.count(b"PK\x01\x02") for part in iter(lambda: stream.read(2**20), b"")) > MEMBERS:
        raise ValueError(f"it must hold at most {MEMBERS} members, got more")
    archive = zipfile.ZipFile(stream)
    members = archive.infolist()
    if len({each.filename for each in members}) < len(members):
        raise ValueError("its members must have names of their own, got one twice")
    allowed = {zipfile.ZIP_STORED: "stored"} | (
        {} if stored is not None else {zipfile.ZIP_DEFLATED: "deflate"}
    )
    for each in members:
        if each.compress_type not in allowed or each.flag_bits & 1:
            method = "encryption" if each.flag_bits & 1 else f"method {each.compress_type}"
            raise ValueError(
                f"{each.filename!r} must be compressed by {' or '.join(allowed.values())}, "
                f"got {method}"
            )
    if stored is not None:
        plain = [each.file_size for each in members if each.filename.endswith(".pkl")]
        if sum(plain) > stored:
            raise ValueError(f"its plain values must have at most {stored} bytes, got {sum(plain)}")
        if sum(each.file_size for each in members) > size:
            raise ValueError(f"its members must fit into its {size} bytes, got larger ones")
        if (damaged := archive.testzip()) is not None:
            raise ValueError(f"{damaged!r} is not as it was written: its checksum differs")
    return archive


def write_arrays(stream: IO[bytes], parts: Mapping[str, Any], compressed: bool = False) -> None:
    """Write the named arrays in `parts` as an .npz file. The file's comment holds a checksum.

    The checksum shows damage. It does not prove who wrote the file.
    """
    (np.savez_compressed if compressed else np.savez)(stream, **parts)
    with zipfile.ZipFile(stream, "a") as archive:
        archive.comment = CHECKSUM + b"0" * 64
    stream.seek(-64, os.SEEK_END)
    stream.write(_hash_before(stream, stream.tell()))


def _hash_before(stream: IO[bytes], end: int) -> bytes:
    """Compute the SHA-256 digest of the bytes before `end`, and leave the stream at `end`."""
    hashed = hashlib.sha256()
    stream.seek(0)
    while part := stream.read(min(2**20, end - stream.tell())):
        hashed.update(part)
    return hashed.hexdigest().encode()


def _check_sum(stream: IO[bytes], comment: bytes) -> None:
    """Raise a ValueError if `comment` holds a checksum that is not the file's checksum."""
    if comment and comment != CHECKSUM + _hash_before(stream, stream.seek(0, os.SEEK_END) - 64):
        raise ValueError("it is not as it was written: its checksum differs")


class ArrayFile:
    """The arrays of an .npz file; each header is checked before unpacking.

    Raises:
        ValueError: the file is invalid.
        FileNotFoundError: the file does not exist.
    """

    def __init__(self, file: Path) -> None:
        self._stream = _open(file, ARCHIVE)
        try:
            self._archive = check_archive(self._stream)
            _check_sum(self._stream, self._archive.comment)
        except DAMAGE as error:
            self._stream.close()
            raise ValueError(describe_damage(error)) from None
        members = self._archive.infolist()
        self._sizes = {each.filename: each.file_size for each in members}
        self._most = {each.filename: most_unpacked(each.compress_size) for each in members}

    def __enter__(self) -> "ArrayFile":
        return self

    def __exit__(self, *_: object) -> None:
        self._archive.close()
        self._stream.close()

    def __contains__(self, name: str) -> bool:
        return f"{name}.npy" in self._sizes

    def read(self, name: str, most: int) -> NDArray[Any]:
        """Read an array of at most `most` bytes, or raise a ValueError."""
        member = f"{name}.npy"
        with self._naming(name), self._archive.open(member) as stream:
            shape, _, kind = _HEADERS[np.lib.format.read_magic(stream)](stream)
            left = self._sizes[member] - stream.tell()
        if kind.kind not in "biufU" or kind.itemsize == 0:
            raise ValueError(f"{name} must hold numbers or text, got {kind!s:.60}")
        if min(shape, default=0) < 0 or math.prod(shape) * kind.itemsize != left:
            raise ValueError(f"{name} must fill its {left} bytes, got {shape} of {kind!s:.60}")
        most = min(most, self._most[member])
        if left > most:
            raise ValueError(f"{name} must be of at most {most} bytes, got {left}")
        with self._naming(name), self._archive.open(member) as stream:
            found: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
        return found

    @staticmethod
    @contextmanager
    def _naming(name: str) -> Iterator[None]:
        try:
            yield
        except DAMAGE as error:
            raise ValueError(f"{name} is damaged: {describe_damage(error)}") from None


_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")


def parse_number(name: str, text: str) -> float:
    """Parse a finite number in decimal digits 0 to 9, or raise an error."""
    plain = text.strip()
    found = float(plain) if _NUMBER.fullmatch(plain) else math.nan
    if not math.isfinite(found):
        raise ValueError(f"{name} must be a finite number, got {text!r:.60}")
    return found


def parse_integer(name: str, text: str) -> int:
    """Parse an integer in decimal digits 0 to 9, or raise an error."""
    if not re.fullmatch(r"[+-]?[0-9]{1,300}", text):
        raise ValueError(f"{name} must be a whole number, got {text!r:.60}")
    return int(text)
