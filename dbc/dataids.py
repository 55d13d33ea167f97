"""The rule that derives E2E data ids from a CAN id if a DBC does not list them."""

from __future__ import annotations


def p02_data_ids(can_id: int) -> bytes:
    """Profile 2 list of a CAN id: entry i = ((id ^ (id >> 6) * 16) & 0xFF) ^ 2i ^ 4i, i = 0..15.

    The lists of all messages of the set differ. The rule is chosen so that every error of up to
    three bits is detected, errors in the counter (which selects the entry) included.
    """
    base = (can_id ^ (can_id >> 6) * 16) & 0xFF
    return bytes(base ^ (2 * i) ^ (4 * i) for i in range(16))
