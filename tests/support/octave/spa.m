% Blackman-Tukey spectra by octave-signal's xcorr: the outside opinion on hapticd.signal.spectra.
%   octave-cli --norc spa.m INPUT OUTPUT LAG RATE_HZ
% INPUT: two columns, force and velocity. OUTPUT: frequency, Phi_u, Phi_y, Re and Im Phi_yu, |G|, noise Phi_v, sd of G.
pkg load signal
arguments = argv();
data = load(arguments{1});
lag = str2double(arguments{3});
rate = str2double(arguments{4});
y = detrend(data(:, 1), 1);
u = detrend(data(:, 2), 1);
n = rows(data);
t = (-lag:lag)';
window = 0.5 * (1 + cos(pi * t / lag));
frequency = (0:lag)' * rate / (2 * lag);
kernel = exp(-1i * 2 * pi * frequency / rate * t');
auto_u = real(kernel * (window .* xcorr(u, lag, "biased")));
auto_y = real(kernel * (window .* xcorr(y, lag, "biased")));
cross = kernel * (window .* xcorr(y, u, lag, "biased"));
gain = cross ./ auto_u;
noise = auto_y - abs(cross) .^ 2 ./ auto_u;
sd = sqrt(sum(window .^ 2) / n * noise ./ auto_u);
result = [frequency, auto_u, auto_y, real(cross), imag(cross), abs(gain), noise, sd];
file = fopen(arguments{2}, "w");
fprintf(file, [repmat("%.17g ", 1, columns(result)), "\n"], result');
fclose(file);
