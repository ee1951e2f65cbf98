"""What is pushed: events to many clients, live pictures of shots."""
