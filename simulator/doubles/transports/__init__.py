"""Transports to the doubles: the vendors' C libraries, the wire, gRPC, a test's own control."""
