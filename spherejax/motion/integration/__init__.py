"""From one state to the next until the end: steps, audit, rows of derivatives, single runs and lanes."""
