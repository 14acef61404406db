"""Certificates: how far machines may be off before a law fails, from below and from above."""
