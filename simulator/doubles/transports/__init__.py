"""How a client comes in: the vendors' C libraries, the wire, gRPC, a test's own control."""
