"""Shared by all pages: design language, ES modules, serving, and a local page."""
