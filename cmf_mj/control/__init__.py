"""The digital control law (DCL), one module per block of Figure 2-6, in signal order."""
