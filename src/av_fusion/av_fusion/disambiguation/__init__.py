"""Telling front from back by turning."""
