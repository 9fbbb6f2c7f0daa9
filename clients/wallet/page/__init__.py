"""The server side of the wallet's page."""
