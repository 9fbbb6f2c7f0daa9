"""The client library: build, sign, submit, verify. It trusts no node."""
