"""Custody across a network: custodians' status and search for remains of records."""
