"""SROS 2: the policy of the suite, and the keys and signed documents that DDS makes nodes keep to it with."""
