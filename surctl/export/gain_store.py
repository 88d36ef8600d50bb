"""Storage of gains in the bytes of the exported C: key of the law, head, CRC-32, and the id of law and gains."""

from __future__ import annotations

import hashlib
import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.bundle import numbers_sha256
from surctl.export.contract import Exportable
from surctl.ir import Real

__all__ = ["gains_id", "gains_values", "stored_gains"]

_VERSION = 1
_KEY = 8  # bytes


def _law_key(law: Exportable, real: Real) -> str:
    """Return 16 hexadecimal digits that depend on instruction list, period, precision and initial state, not on gains.

    They are the first digits of the SHA-256 of the same lines as those of the law's id, without the gains.
    """
    lines = [law.block.digest(), float(law.dt).hex(), real, numbers_sha256(law.initial_state().tolist())]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[: 2 * _KEY]


def stored_gains(law: Exportable, gains: NDArray[np.float64], real: Real) -> bytes:
    """Return the bytes in which the exported `gains_save` stores gains (np,); every number is little-endian."""
    body = _head(law, real) + np.asarray(gains, dtype=real).astype(np.dtype(real).newbyteorder("<")).tobytes()
    return body + struct.pack("<I", zlib.crc32(body))


def gains_id(law: Exportable, gains: NDArray[np.float64], real: Real) -> str:
    """Return the id of law and gains that the exported `gains_id` computes, as 8 hexadecimal digits."""
    return f"{struct.unpack('<I', stored_gains(law, gains, real)[-4:])[0]:08x}"


def gains_values(law: Exportable, real: Real) -> dict[str, Any]:
    """Return the values of the template of the C file that stores gains."""
    head = _head(law, real)
    return {
        "gains_head": ", ".join(f"0x{byte:02x}U" for byte in head),
        "gains_bytes": len(head) + law.gains.size * np.dtype(real).itemsize + 4,
    }


def _head(law: Exportable, real: Real) -> bytes:
    width = np.dtype(real).itemsize
    return b"SURG" + struct.pack("<HHI", _VERSION, width, law.gains.size) + bytes.fromhex(_law_key(law, real))
