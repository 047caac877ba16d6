"""A service whose answers a test writes, as a client of the library meets it."""

import httpx2

from truepath.client import Client


class Script:
    """Answers requests in turn; an exception in place of an answer is a lost one."""

    def __init__(self, *answers):
        self.answers, self.requests = list(answers), []

    def __call__(self, request):
        self.requests.append(request)
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def open(self, address="http://mill"):
        return Client(address, transport=httpx2.MockTransport(self))


def answer(status, content, **headers):
    return httpx2.Response(status, json=content, headers=headers)
