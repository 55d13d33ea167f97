"""The rule that turns a CAN id into E2E data ids, where a DBC does not list them."""

from __future__ import annotations


def p02_data_ids(can_id: int) -> bytes:
    """Profile 2 list of a CAN id: entry i = ((id ^ (id >> 6) * 16) & 0xFF) ^ 2i ^ 4i, i = 0..15.

    The contract's rule: distinct for every message of the set, and chosen so that no error of
    up to three bits goes unseen, the counter (which selects the entry) included.
    """
    base = (can_id ^ (can_id >> 6) * 16) & 0xFF
    return bytes(base ^ (2 * i) ^ (4 * i) for i in range(16))
