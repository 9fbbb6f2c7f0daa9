"""A person's export bundle: its form, how it is written, and how anybody checks it."""
