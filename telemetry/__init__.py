"""What a drive leaves behind: the bus log, the samples, the report and the pictures."""
