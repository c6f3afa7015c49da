"""`python -m dbw`."""

import sys

from dbw.main import main

sys.exit(main())
