"""hapticd: a real-time haptic servo daemon, its gateway and its simulated board.

    import hapticd

    with hapticd.Client() as device:
        device.set(K=100, B=1)
        device.enable()

    Client, AsyncClient   one connection to a running daemon, waiting or with asyncio
    Staircase             an adaptive staircase, for thresholds
    GuardWarning          emitted where a change acts that is not safe
    open_recording        a recording, by its file
    load_scene            a scene, by its name or file
    virtual_board         servo, guard and simulated board on virtual time: a Client without daemon

They are loaded when they are first used; `import hapticd` itself loads the standard library alone.
"""

from typing import TYPE_CHECKING

from hapticd.core.lazy import lazily

if TYPE_CHECKING:
    from hapticd.client.aio import AsyncClient
    from hapticd.client.client import Client
    from hapticd.client.design import Staircase
    from hapticd.core.errors import GuardWarning
    from hapticd.recording.file import open_recording
    from hapticd.run.virtual import virtual_board
    from hapticd.settings.scene import load_scene

__all__ = [
    "AsyncClient",
    "Client",
    "GuardWarning",
    "Staircase",
    "__version__",
    "load_scene",
    "open_recording",
    "virtual_board",
]

__version__ = "0.1.0"

__getattr__, __dir__ = lazily(
    __name__,
    {
        "AsyncClient": "hapticd.client.aio",
        "Client": "hapticd.client.client",
        "GuardWarning": "hapticd.core.errors",
        "Staircase": "hapticd.client.design",
        "load_scene": "hapticd.settings.scene",
        "open_recording": "hapticd.recording.file",
        "virtual_board": "hapticd.run.virtual",
    },
)
