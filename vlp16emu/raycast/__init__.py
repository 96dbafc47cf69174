"""Ray casting of pulses against near faces and the far medium; the only border to float32."""
