"""Workers: processes of this machine or of a Ray cluster, and how work is handed out to them."""
