"""SAPIENT (BSI Flex 335 v2.0): messages, their framing and validation, and the session of a node with its fusion node."""
