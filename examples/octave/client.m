% A client in Octave: set a spring, enable, look at the state, disable. MATLAB has the same jsonencode
% and jsondecode; there the socket comes from JeroMQ or py.zmq.
%
%   octave-cli client.m ENDPOINT         (Debian: octave-zeromq)
%
% ENDPOINT: command endpoint of `hapticd status --json`, endpoints.command
pkg load zeromq

function reply = ask (socket, request)
  zmq_send (socket, jsonencode (request));
  if ! zmq_poll (socket, 2000)
    error ("%s: no reply within 2 s; is `hapticd run` running?", request.cmd);
  end
  received = zmq_recv (socket, 65536);
  reply = jsondecode (char (received));
  if ! reply.ok
    error ("%s: %s", request.cmd, reply.error.message);
  end
end

endpoint = argv (){1};
socket = zmq_socket (ZMQ_REQ);
zmq_connect (socket, endpoint);
ask (socket, struct ("cmd", "hello", "id", 1, "name", "octave"));
reply = ask (socket, struct ("cmd", "set", "id", 2, "K", 100, "B", 1));
printf ("in force from tick %d on: K = %g N/m\n", reply.receipt.first_tick, reply.receipt.effective.K);
ask (socket, struct ("cmd", "enable", "id", 3));
reply = ask (socket, struct ("cmd", "get", "id", 4));
printf ("state: %s\n", reply.state);
ask (socket, struct ("cmd", "disable", "id", 5));
zmq_close (socket);
