"""Signals out of many frames at once: numpy columns in, numpy columns out."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dbc.protection import COUNTER_BYTE, PROTECTED_LENGTH, crc
from telemetry.databases import Signal

WORD_BITS: Final = 64
WORD_BYTES: Final = 8
_FLOATS: Final = {
    16: (np.uint16, np.float16), 32: (np.uint32, np.float32), 64: (np.uint64, np.float64),
}  # fmt: skip


def raw_of(signal: Signal, data: NDArray[np.uint8]) -> NDArray[Any]:
    """A signal's bits as numbers, before scaling.

    Args:
        signal: Of up to 64 bits, of either byte order.
        data: Shape (N, W), as long as the message at least.

    Returns:
        Shape (N,): uint64, int64 for a signed signal, a float type for a float.
    """
    is_word = data.shape[1] == WORD_BYTES and data.flags.c_contiguous
    if is_word and signal.byte_order == "little_endian":
        words = data.view("<u8")[:, 0] >> np.uint64(signal.start)
    elif is_word:
        begin = _begin(signal)
        words = data.view(">u8")[:, 0].astype(np.uint64)
        words >>= np.uint64(WORD_BITS - begin - signal.length)
    else:
        words = _words(*_window(signal, data))
    return _number(signal, words)


def _begin(signal: Signal) -> int:
    """Bits of a frame before a big-endian signal, whose start bit is the most significant one."""
    start: int = signal.start
    return 8 * (start // 8) + 7 - start % 8


def _window(signal: Signal, data: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], int]:
    """The bytes that a signal is in, the least significant first, and its place in the first."""
    if signal.byte_order == "little_endian":
        first, shift = signal.start // 8, signal.start % 8
        return data[:, first : first + -(-(shift + signal.length) // 8)], shift
    begin = _begin(signal)
    first, last = begin // 8, (begin + signal.length - 1) // 8
    shift = 8 * (last + 1) - begin - signal.length
    return data[:, first : last + 1][:, ::-1], shift


def _number(signal: Signal, words: NDArray[np.uint64]) -> NDArray[Any]:
    """A signal's number in words that begin with it."""
    if signal.length < WORD_BITS:
        words &= np.uint64((1 << signal.length) - 1)
    if signal.is_float:
        unsigned, kind = _FLOATS[signal.length]
        return words.astype(unsigned).view(kind)
    if not signal.is_signed:
        return words
    signed = words.view(np.int64)
    if signal.length == WORD_BITS:
        return signed
    sign = np.int64(1 << (signal.length - 1))
    return (signed ^ sign) - sign


def _words(window: NDArray[np.uint8], shift: int) -> NDArray[np.uint64]:
    """Bytes, least significant first, as 64-bit words shifted down; up to nine of them."""
    padded = np.zeros((len(window), 8), np.uint8)
    padded[:, : window.shape[1]] = window[:, :8]
    words = padded.view("<u8")[:, 0].astype(np.uint64) >> np.uint64(shift)
    if window.shape[1] > 8:
        words |= window[:, 8].astype(np.uint64) << np.uint64(WORD_BITS - shift)
    return words


def _table() -> NDArray[np.uint8]:
    """What each byte adds to the CRC at its own place, shape (8, 256): the CRC is linear."""
    zero = crc(bytes(PROTECTED_LENGTH), 0)
    rows = [
        [
            crc(bytes(value if n == place else 0 for n in range(PROTECTED_LENGTH)), 0) ^ zero
            for value in range(256)
        ]
        for place in range(1, PROTECTED_LENGTH)
    ]  # fmt: skip
    return np.array([[0] * 256, *rows], np.uint8)


_CRC_OF_BYTE: Final = _table()


def is_crc_right(data: NDArray[np.uint8], data_id: int) -> NDArray[np.bool_]:
    """Whether byte 0 of each frame is the CRC-8 of the rest (AUTOSAR E2E Profile 1).

    Args:
        data: Shape (N, 8).
        data_id: The DBC's E2EDataId.
    """
    found = np.full(len(data), crc(bytes(PROTECTED_LENGTH), data_id), np.uint8)
    for place in range(1, PROTECTED_LENGTH):
        found ^= _CRC_OF_BYTE[place][data[:, place]]
    result: NDArray[np.bool_] = found == data[:, 0]
    return result


def counter_of(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The alive counter of each frame."""
    return data[:, COUNTER_BYTE] & np.uint8(0x0F)
