from sys import argv

from stereo_client import Client

with Client(argv[1]) as client:
    for result in client.stream(argv[2]):
        print(result.sequence, result.report)
