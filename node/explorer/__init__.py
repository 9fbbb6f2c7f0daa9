"""The explorer's pages, which every node serves below /explorer/."""
