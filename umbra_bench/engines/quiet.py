"""Libraries that greet when they are imported, on streams that belong to the reader's data."""

from __future__ import annotations

import contextlib
import ctypes
import os
import warnings
from collections.abc import Iterator


@contextlib.contextmanager
def quietly() -> Iterator[None]:
    """Send what native code prints to nowhere; hide warnings (an error among them would crash)."""
    kept = {stream: os.dup(stream) for stream in (1, 2)}
    nowhere = os.open(os.devnull, os.O_WRONLY)
    flush = getattr(ctypes.CDLL(None), "fflush", None)
    try:
        if flush:
            flush(None)
        for stream in kept:
            os.dup2(nowhere, stream)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        if flush:
            flush(None)
        for stream, copy in kept.items():
            os.dup2(copy, stream)
            os.close(copy)
        os.close(nowhere)
