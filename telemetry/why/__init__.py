"""Why a drive ended, or never began: from the frames of the bus alone, in a log or live."""
