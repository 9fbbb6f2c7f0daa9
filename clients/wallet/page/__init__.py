"""The server side of the wallet's page. Must never hold a rule of its own: it asks the modules that the commands ask."""
