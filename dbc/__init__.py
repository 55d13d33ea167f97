"""Everything that knows about bits: message set, codec, protection, candump text. No maths."""
