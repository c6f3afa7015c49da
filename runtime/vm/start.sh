# In the guest, within the host's file system: networks up, then the command.
PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
job=/run/dbw-job
ip link set lo up
for name in vcan0 vcan1; do ip link add "$name" type vcan && ip link set "$name" up; done
for name in can0 can1; do
    ip link set "$name" up txqueuelen 1000 type can bitrate 500000 restart-ms 100
done
for port in /sys/class/virtio-ports/*; do
    read -r name < "$port/name"
    ln -s "/dev/${port##*/}" "/run/$name"
done
ln -s /proc/self/fd /dev/fd
for number in 0:stdin 1:stdout 2:stderr; do
    ln -s "/proc/self/fd/${number%:*}" "/dev/${number#*:}"
done
echo booted > $job/state
if [ -e $job/interactive ]; then
    stty $(cat $job/interactive) < /dev/ttyS0
    setsid -c sh $job/command.sh < /dev/ttyS0 > /dev/ttyS0 2>&1
else
    sh $job/command.sh < /dev/null > /run/stdout 2> /run/stderr
fi
echo $? > $job/exit
