import sys
from pathlib import Path

# Workers find jobs.py along the path of the process that starts them.
sys.path.append(str(Path(__file__).parent))
