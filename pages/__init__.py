"""What all pages share: the design language, small ES modules, how they are served, and a page for one person alone.

Wallet, explorer, console and reports build on it.
"""
