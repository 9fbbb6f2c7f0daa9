"""What stands on the chain: typed rows, their keys, and the questions that several readers ask. One module a contract."""
