"""Everything that depends on bits: message set, codec, protection, candump text. No maths."""
