"""Tests of the folders below find `fleet_unit` here."""
