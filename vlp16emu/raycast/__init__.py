"""Ray casting: the sub-rays of each pulse against near faces and the far medium. The only border to float32."""
