"""The explorer's pages, which every node serves below /explorer/. Must never hold data: what they show they ask the API."""
