"""What turns Python functions into machine code: declarations, vector instructions."""
