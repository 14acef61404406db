"""The machines that agree with what the report tells, and what laws do on them."""
