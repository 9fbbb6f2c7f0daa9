"""The HTTP interface of one node. Must never answer a question that its caller may not ask."""
