"""Publishing a word so that no reader sees it before the data it announces.

On x86-64 an aligned 8-byte store from a memoryview is one `mov`, stores are not reordered with
earlier stores (TSO), and the call into C stops the compiler: a plain assignment is a release store.
On aarch64 the same store is single-copy atomic but may overtake the data written before it, so the
word is stored by libatomic's `__atomic_store_8(..., RELEASE)` and read by `__atomic_load_8(...,
ACQUIRE)`. A Python lock or a bare `dmb`-less store would not do: neither is documented as a
barrier. Records carry their number first and last and commands carry a CRC, so a mistake here is
detected, not believed.
"""

import ctypes
import platform
from collections.abc import Callable

from hapticd.errors import MailboxError

# __ATOMIC_RELEASE, __ATOMIC_ACQUIRE
RELEASE = 3
ACQUIRE = 2
STRONGLY_ORDERED = frozenset({"x86_64", "amd64", "AMD64", "i686"})

Store = Callable[[int, int], None]
Load = Callable[[int], int]


def plain_store(machine: str | None = None) -> bool:
    """Whether a plain assignment publishes on this (or the named) machine: what a tick may do
    without a call.
    """
    return (machine or platform.machine()) in STRONGLY_ORDERED


def word_access(words: "memoryview[int]", machine: str | None = None) -> tuple[Store, Load]:
    """`(store(index, value), load(index))` with release and acquire order for u64 `words` on this
    (or the named) machine.

    Raises MailboxError where the machine is weakly ordered and libatomic is missing.
    """
    if plain_store(machine):
        return words.__setitem__, words.__getitem__
    return _libatomic_access(words)


def _libatomic_access(words: "memoryview[int]") -> tuple[Store, Load]:
    try:
        library = ctypes.CDLL("libatomic.so.1")
    except OSError as error:
        raise MailboxError(
            f"this processor needs libatomic for ordered stores ({error}); install libatomic1"
        ) from error
    put = library.__atomic_store_8
    get = library.__atomic_load_8
    put.argtypes = (ctypes.c_void_p, ctypes.c_uint64, ctypes.c_int)
    put.restype = None
    get.argtypes = (ctypes.c_void_p, ctypes.c_int)
    get.restype = ctypes.c_uint64
    anchor = ctypes.c_char.from_buffer(words)  # holds the map; its address is the address of word 0
    base = ctypes.addressof(anchor)

    def store(index: int, value: int, _anchor: ctypes.c_char = anchor) -> None:
        put(base + 8 * index, value, RELEASE)

    def load(index: int, _anchor: ctypes.c_char = anchor) -> int:
        return int(get(base + 8 * index, ACQUIRE))

    return store, load
