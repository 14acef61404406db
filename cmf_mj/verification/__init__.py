"""Cross-verification of the MuJoCo plant by an independent multibody engine."""
