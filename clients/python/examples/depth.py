from sys import argv

from stereo_client import Client

with Client(argv[3]) as client:
    result = client.match(argv[1], argv[2], budget_ms=200, density="dense")
print(result.report)
result.save("depth.png", "color")
