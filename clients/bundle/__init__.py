"""A person's export bundle: its format, writing and verification."""
