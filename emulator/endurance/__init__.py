"""How long it holds: soaks with hosts that come, go and misbehave (`soak`, `real_soak`), and fuzzing (`fuzz`)."""
