"""The machines that agree with what the report says, and what laws do on them."""
