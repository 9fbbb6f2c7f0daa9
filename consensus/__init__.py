"""Everything all parties must agree on, bit for bit. Pure: no I/O, no clock, no randomness, no asyncio."""
