import sys
from pathlib import Path

from bare_drawings import bare_drawings as bare_drawings

# Tests in the folders below make records by the module synthetic.
sys.path.append(str(Path(__file__).parent))
