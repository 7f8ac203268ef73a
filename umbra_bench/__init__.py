"""umbra-bench."""
