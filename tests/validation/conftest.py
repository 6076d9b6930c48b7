import sys
from pathlib import Path

# Tests in the folders below make records by the module synthetic.
sys.path.append(str(Path(__file__).parent))
