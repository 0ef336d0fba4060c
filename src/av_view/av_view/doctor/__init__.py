"""Checks of a machine and its sensors before the first launch. Each judges facts that it is given; `program` collects them."""
